"""What may be in a scene: how many screws of which kind, where they stand, how the C-arm sees them."""

import math
from dataclasses import dataclass
from typing import Literal

from screwpose.errors import InputError

MAX_SCREWS = 16
MAX_LEVELS = 8
Range = tuple[float, float]
"""Least and largest value, both allowed; draws are uniform between them unless it is said otherwise."""


@dataclass(frozen=True)
class SceneOptions:
    """The ranges that a scene is drawn from; the defaults are two screws with towers that overlap in LAT.

    Parameters
    ----------
    screws, levels : how many, and over how many vertebrae next to each other; at most one screw a side of each. Few
        levels are drawn more often than many.
    lengths_mm, diameters_mm : of the shanks, in steps of 5 mm and of 0.5 mm.
    designs : how many different designs of screw there are, at most one for each screw.
    polyaxial, tower : the share of the designs that are polyaxial, and that carry a tower.
    tower_length_mm : in steps of 10 mm.
    tower_tilt_deg : how far the heads of polyaxial screws lean; towards any side.
    convergence_deg : towards the middle; less where the tips would meet.
    cranial_tilt_deg : standard deviation of the screws' common tilt towards the patient's head or feet.
    asymmetry : how unlike left and right are: 0 puts one behind the other in LAT, 1 tilts each by up to 8 degrees and
        moves it by up to 2.5 mm along the spine.
    depth_mm : of the middle of the shank before (negative) or behind the middle of the pedicle.
    angle_deg : between the viewing directions of AP and LAT, exactly.
    pose_sd_deg, isocenter_sd_mm : how well the C-arm was put up: its tilts, and the point it turns about.
    shift_mm : how far one of the views is off along the spine: screws at the end leave its field.
    overlap_lat : in LAT, the largest share of a screw's silhouette that the others cover.
    missing : how many marks are missing, each screw's in one view at most: those outside the field, then, in LAT, those
        of screws that others cover most. At least two screws keep both marks, or one of two.
    clutter : how many pieces of other metal.
    models_named : whose marks name the model of the screw: those of all views, of AP (as planned, LAT not), of none.
    max_epipolar_gap_px : two screws: the mean epipolar distance of the marks changes by less than this where their
        labels are swapped. None: it does not matter.
    needles : for each screw, X-rays with a needle along its tower are added.
    round_field : how often the field is an image intensifier's. From five levels on it never is.
    detector_mm : width of the detector; None: 307 mm up to four levels, 430 mm beyond.
    image_size : (width, height) in px.

    Raises
    ------
    InputError
        A range that is empty or beyond what there can be; names the field.
    """

    screws: tuple[int, int] = (2, 2)
    levels: tuple[int, int] = (1, 2)
    lengths_mm: Range = (40.0, 50.0)
    diameters_mm: Range = (5.5, 7.5)
    designs: tuple[int, int] = (1, 1)
    polyaxial: float = 0.0
    tower: float = 1.0
    tower_length_mm: Range = (80.0, 100.0)
    tower_tilt_deg: Range = (0.0, 0.0)
    convergence_deg: Range = (10.0, 30.0)
    cranial_tilt_deg: float = 4.0
    asymmetry: Range = (0.0, 1.0)
    depth_mm: Range = (-2.0, 2.0)
    angle_deg: Range = (84.0, 96.0)
    pose_sd_deg: float = 2.5
    isocenter_sd_mm: float = 5.0
    shift_mm: Range = (0.0, 0.0)
    overlap_lat: Range = (0.05, 1.0)
    missing: tuple[int, int] = (0, 0)
    clutter: tuple[int, int] = (0, 0)
    models_named: Literal["all", "AP", "none"] = "all"
    max_epipolar_gap_px: float | None = None
    needles: bool = False
    round_field: float = 0.35
    detector_mm: float | None = None
    image_size: tuple[int, int] = (1024, 1024)

    def __post_init__(self) -> None:
        for name, (least, most) in _BOUNDS.items():
            _check_range(name, getattr(self, name), least, most)
        for name in ("polyaxial", "tower", "round_field"):
            _check_range(name, (getattr(self, name),) * 2, 0.0, 1.0)
        for name in ("cranial_tilt_deg", "pose_sd_deg", "isocenter_sd_mm"):
            _check_range(name, (getattr(self, name),) * 2, 0.0, 30.0)
        if self.levels[0] > self.screws[1] or 2 * self.levels[1] < self.screws[0]:
            raise InputError(
                f"{_shown(self.screws)} screws over {_shown(self.levels)} levels",
                field="levels",
                expected="one or two screws on each level",
            )
        if self.missing[0] > most_missing(self.screws[1]):
            raise InputError(
                f"{_shown(self.missing)} marks missing of {_shown(self.screws)} screws",
                field="missing",
                expected=f"at most {most_missing(self.screws[1])}, so that two pairs are left, or one of two screws",
            )
        if self.max_epipolar_gap_px is not None and self.screws != (2, 2):
            raise InputError(
                f"a bound on the epipolar gap for {_shown(self.screws)} screws",
                field="max_epipolar_gap_px",
                expected="two screws",
            )
        if self.tower_tilt_deg[1] > 0.0 and self.polyaxial == 0.0:
            raise InputError(
                f"towers that lean by {_shown(self.tower_tilt_deg)} degrees on monoaxial screws",
                field="tower_tilt_deg",
                remedy="Set polyaxial, or leave the tilt at 0.",
            )


def most_missing(screws: int) -> int:
    """How many marks may be missing so that two pairs are left, or one of two screws."""
    return screws - max(1, min(2, screws - 1))


_BOUNDS: dict[str, Range] = {
    "screws": (1, MAX_SCREWS),
    "levels": (1, MAX_LEVELS),
    "lengths_mm": (25.0, 80.0),
    "diameters_mm": (4.0, 10.0),
    "designs": (1, MAX_SCREWS),
    "tower_length_mm": (60.0, 200.0),
    "tower_tilt_deg": (0.0, 25.0),
    "convergence_deg": (0.0, 45.0),
    "asymmetry": (0.0, 2.0),
    "depth_mm": (-15.0, 15.0),
    "angle_deg": (20.0, 160.0),
    "shift_mm": (0.0, 150.0),
    "overlap_lat": (0.0, 1.0),
    "missing": (0, MAX_SCREWS),
    "clutter": (0, 40),
}


def _check_range(name: str, given: Range, least: float, most: float) -> None:
    if not all(math.isfinite(value) for value in given) or not least <= given[0] <= given[1] <= most:
        raise InputError(
            f"{_shown(given)} is no range for this", field=name, expected=f"from {least:g} to {most:g}, the least first"
        )


def _shown(given: Range) -> str:
    return f"{given[0]:g}" if given[0] == given[1] else f"{given[0]:g} to {given[1]:g}"
