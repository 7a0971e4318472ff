"""X-rays by gVXR, an X-ray simulator by others (Vidal & Villard 2016): another tracer on another graphics stack.

It is not among this project's dependencies; see docs/simulation.md for how to run what needs it. gVXR takes one ray
through each pixel's centre, and its meshes may be nested but not overlap.
"""

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.implants.model import Mesh

# Far enough to be behind everything. The image does not depend on it.
DETECTOR_DEPTH_MM = 1000.0


@dataclass(frozen=True, eq=False)
class Piece:
    """A body as gVXR takes it: mass fractions by atomic number, in g/cm^3. `outer` holds all others in it."""

    mesh: Mesh
    elements: dict[int, float]
    density_g_per_cm3: float
    outer: bool = False


def loaded_gvxr() -> Any:
    """The module, with a graphics context that needs no screen.

    Raises
    ------
    ImportError
        gVXR, or a system library that it needs, is not installed.
    """
    from gvxrPython3 import gvxr

    with _quiet():
        gvxr.createWindow(-1, 0, "EGL", 4, 5)
    return gvxr


def gvxr_image(
    gvxr: Any, camera: Camera, pieces: Sequence[Piece], energies_kev: FloatArray, signal: FloatArray
) -> FloatArray:
    """Transmission (rows, columns) at the pixels' centres.

    Parameters
    ----------
    energies_kev, signal : (E,), the energies and each one's share of the signal where nothing is in the way.
    """
    assert camera.image_size is not None
    width, height = camera.image_size
    inverse = np.linalg.inv(camera.projection[:, :3])
    source = camera.center_in_world_mm
    right, down = DETECTOR_DEPTH_MM * inverse[:, 0], DETECTOR_DEPTH_MM * inverse[:, 1]
    middle = source + DETECTOR_DEPTH_MM * inverse @ [(width - 1) / 2, (height - 1) / 2, 1.0]
    with _quiet():
        gvxr.removePolygonMeshesFromSceneGraph()
        gvxr.removePolygonMeshesFromXRayRenderer()
        gvxr.resetBeamSpectrum()
        gvxr.usePointSource()
        gvxr.setSourcePosition(*source, "mm")
        gvxr.setDetectorPosition(*middle, "mm")
        gvxr.setDetectorRightVector(*(right / np.linalg.norm(right)))
        gvxr.setDetectorUpVector(*(-down / np.linalg.norm(down)))
        gvxr.setDetectorNumberOfPixels(width, height)
        gvxr.setDetectorPixelSize(float(np.linalg.norm(right)), float(np.linalg.norm(down)), "mm")
        for energy, share in zip(energies_kev, signal, strict=True):
            if share > 0.0:
                # The image is the energy that arrives: photons times energy.
                gvxr.addEnergyBinToSpectrum(float(energy), "keV", float(1e6 * share / energy))
        for number, piece in enumerate(pieces):
            label = f"piece{number}"
            fine = _fine(piece.mesh)
            gvxr.makeTriangularMesh(label, fine.vertices_mm.ravel().tolist(), fine.faces.ravel().tolist(), "mm")
            gvxr.setMixture(label, list(piece.elements), list(piece.elements.values()))
            gvxr.setDensity(label, piece.density_g_per_cm3, "g/cm3")
            (gvxr.addPolygonMeshAsOuterSurface if piece.outer else gvxr.addPolygonMeshAsInnerSurface)(label)
        image = np.array(gvxr.computeXRayImage(True), dtype=np.float64)
        open_beam = float(gvxr.getTotalEnergyWithDetectorResponse())
    # Its rows run along the up vector, from the bottom.
    return image.reshape(height, width)[::-1] / open_beam


def _fine(mesh: Mesh) -> Mesh:
    """The same surface in faces of at most 3 mm.

    gVXR takes the distance from the source as linear over a face. On the 100 mm long faces of a tower that is wrong by
    millimetres; the error falls with the square of the size: 0.4, 0.06 and 0.02 per cent of the transmission at 10, 4
    and 2 mm.
    """
    import trimesh

    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices_mm, mesh.faces, 3.0, max_iter=20)
    return Mesh(np.asarray(vertices), np.asarray(faces))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """gVXR writes what it does to the process's own streams."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(sink, stream)
        yield
    finally:
        for stream, original in zip((1, 2), kept, strict=True):
            os.dup2(original, stream)
            os.close(original)
        os.close(sink)
