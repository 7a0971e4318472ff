"""The cases that methods are measured on, as folders of files: what a user would have.

A set's cases never change under one version. Seeds below 1000 are for development: tune on them as you like. Seeds from
2026 on are for reporting: what is published was never tuned on. (1000 to 2025 are free.)
"""

from screwpose.benchmark.sets_base import BenchmarkSet, MakeCase, case_seed
from screwpose.benchmark.sets_other import OTHER
from screwpose.benchmark.sets_real import REAL, biplane_folder, landmarks_of_no_screw
from screwpose.benchmark.sets_simulated import SIMULATED
from screwpose.errors import InputError
from screwpose.files.wording import nearest

__all__ = [
    "SETS",
    "BenchmarkSet",
    "MakeCase",
    "biplane_folder",
    "case_seed",
    "get_set",
    "landmarks_of_no_screw",
]

SETS: dict[str, BenchmarkSet] = {one.name: one for one in (*SIMULATED, REAL, OTHER)}


def get_set(name: str) -> BenchmarkSet:
    """A set by its name.

    Raises
    ------
    InputError
        There is no such set.
    """
    if name not in SETS:
        near = nearest(name, SETS)
        raise InputError(
            f"there is no benchmark set {name!r}",
            field="--set",
            expected=f"one of {', '.join(sorted(SETS))}",
            remedy=f"Did you mean {near}?" if near else None,
        )
    return SETS[name]
