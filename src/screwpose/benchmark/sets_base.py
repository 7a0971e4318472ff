"""What a named set of cases is."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from screwpose.errors import InputError

MakeCase = Callable[[int, int, Path], Path]
"""``make(seed, index, folder) -> path of case.json``, with truth.json beside it."""


@dataclass(frozen=True)
class BenchmarkSet:
    """A named set of cases.

    Parameters
    ----------
    version : of its cases. They never change under one version: a figure belongs to a set and its version.
    make : makes one case in a folder, the same for the same seed and index whatever else was made.
    size : how many cases there are; None where they are made without end.
    origin : where the truth comes from, for the report.
    """

    name: str
    version: int
    make: MakeCase
    size: int | None
    origin: str
    description: str

    def check_index(self, index: int) -> None:
        """Whether there is such a case.

        Raises
        ------
        InputError
            The index is beyond the set's size.
        """
        if index < 0 or (self.size is not None and index >= self.size):
            raise InputError(
                f"the set {self.name!r} has no case {index}",
                field="--index",
                expected=f"0 to {self.size - 1}" if self.size else "0 or more",
            )


def case_seed(set_name: str, seed: int, index: int) -> int:
    """The seed of one case of a set: sets share no cases, and case 7 is the same however many are asked for."""
    stream = np.random.SeedSequence([seed, index, *set_name.encode()])
    return int(stream.generate_state(1, np.uint32)[0])
