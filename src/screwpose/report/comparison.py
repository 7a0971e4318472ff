"""How far an answer is from the known truth: what a caller who has it hands to the report.

The report computes none of it: scoring stands a few floors above (`screwpose.benchmark`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from screwpose.files.result import PosedImplant


@dataclass(frozen=True)
class ScrewComparison:
    """The errors of one screw; None where one does not apply (a roll about a symmetric axis, a screw not in the truth).

    Parameters
    ----------
    labels : the screw's label in each view, as in the answer.
    pairing_right : whether its labels belong together in the truth; its errors mean little where not.
    tip_mm, center_mm, head_mm : distances between the estimated and the true point, mm.
    axis_deg : angle between the axes, degrees.
    roll_deg : rotation about the axis that is left once the axes agree, degrees, signed.
    """

    labels: Mapping[str, str]
    pairing_right: bool = True
    tip_mm: float | None = None
    center_mm: float | None = None
    head_mm: float | None = None
    axis_deg: float | None = None
    roll_deg: float | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """An answer beside the truth.

    Parameters
    ----------
    screws : one for each screw of the answer, in its order.
    true_pairs : the truth's labels by view, one mapping a screw; tells the correct combination from the wrong ones.
    true_implants : the truth's poses, drawn beside the answer where given.
    origin : where the truth comes from, as "simulated" or "an expert's poses, good to some tenths of a mm".
    """

    screws: tuple[ScrewComparison, ...] = ()
    true_pairs: tuple[Mapping[str, str], ...] | None = None
    true_implants: tuple[PosedImplant, ...] = ()
    origin: str = ""
