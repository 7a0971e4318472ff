"""The implants where the answer puts them: STL files in world coordinates, mm."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import OutputError
from screwpose.files.schema import ScrewResultFile
from screwpose.implants.mesh import transformed, write_stl
from screwpose.implants.model import Implant, Mesh

_LONGEST_NAME = 80


def placed_pieces(implant: Implant, screw: ScrewResultFile) -> tuple[tuple[str, Mesh, FloatArray], ...]:
    """The pieces of a screw: (key, mesh in the CAD frame, world_from_cad (4, 4)); its parts where they have poses."""
    if screw.parts and implant.parts:
        whole = np.array(screw.world_from_cad)
        return tuple(
            (
                f"{implant.name}:{part.name}",
                part.mesh,
                np.array(screw.parts[part.name].world_from_cad) if part.name in screw.parts else whole,
            )
            for part in implant.parts
        )
    return ((implant.name, implant.mesh, np.array(screw.world_from_cad)),)


def placed_mesh(implant: Implant, screw: ScrewResultFile) -> Mesh:
    """A screw in the world frame, mm, all its pieces as one mesh."""
    pieces = [transformed(mesh, world_from_cad) for _, mesh, world_from_cad in placed_pieces(implant, screw)]
    first_vertices = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in pieces)])
    faces = [mesh.faces + first for mesh, first in zip(pieces, first_vertices[:-1], strict=True)]
    return Mesh(np.vstack([mesh.vertices_mm for mesh in pieces]), np.vstack(faces))


def write_meshes(folder: Path, screws: Sequence[ScrewResultFile], implants: Mapping[str, Implant]) -> list[Path]:
    """Write ``meshes/screw_{labels}.stl`` for each screw, in world coordinates, mm.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    names = unique_names(
        [f"screw_{'_'.join(f'{view}-{label}' for view, label in one.labels.items())}" for one in screws]
    )
    paths = [folder / "meshes" / f"{name}.stl" for name in names]
    for path, screw in zip(paths, screws, strict=True):
        make_folder(path.parent)
        write_stl(placed_mesh(implants[screw.model], screw), path)
    return paths


def make_folder(path: Path) -> Path:
    """A folder inside the output; there already is fine.

    Raises
    ------
    OutputError
        It cannot be made.
    """
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: the folder cannot be made ({error.strerror}).") from error
    return path


def safe_name(text: str) -> str:
    """Text from a case as part of a file name that every system takes: letters, digits, ``-``, ``_`` and ``.``."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip(".")[:_LONGEST_NAME] or "_"


def unique_names(texts: Sequence[str]) -> list[str]:
    """File names for texts, in order; those that became equal (also but for case) are numbered."""
    names: list[str] = []
    taken: set[str] = set()
    for text in texts:
        base = name = safe_name(text)
        number = 2
        while name.lower() in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name.lower())
        names.append(name)
    return names
