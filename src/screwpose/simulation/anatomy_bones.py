"""Bones that were made once: a table of closed meshes, read when the first patient is built.

Making them takes a second or two, and may differ in the last digits from machine to machine; reading takes some ms, and
gives everybody the same patients. `tools/make_bones.py` makes the table.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.implants.model import Mesh

TABLE = Path(__file__).parent / "tables" / "bones.npz"
_STEP_MM = 0.01  # of the stored coordinates


@cache
def bones_from_table(name: str) -> tuple[Mesh, Mesh]:
    """The surfaces of a bone and of its marrow, mm.

    Parameters
    ----------
    name : ``pelvis``, or a level as in ``L3`` (those of `screwpose.simulation.spine.MADE_LEVELS`).
    """
    with np.load(TABLE) as stored:
        bone, marrow = (
            Mesh(
                stored[f"{name}-{part}-vertices"].astype(np.float64) * _STEP_MM,
                stored[f"{name}-{part}-faces"].astype(np.int64),
            )
            for part in ("bone", "marrow")
        )
    return bone, marrow


def write_bones(bones: Mapping[str, tuple[Mesh, Mesh]], path: Path = TABLE) -> None:
    """Store bones by name; coordinates are rounded to a hundredth of a mm."""
    arrays: dict[str, Any] = {}
    for name, surfaces in bones.items():
        for part, surface in zip(("bone", "marrow"), surfaces, strict=True):
            arrays[f"{name}-{part}-vertices"] = np.round(surface.vertices_mm / _STEP_MM).astype(np.int16)
            arrays[f"{name}-{part}-faces"] = surface.faces.astype(np.uint16)
    np.savez_compressed(path, **arrays)
