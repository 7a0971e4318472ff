"""The scenes in which the simulator is held against gVXR, as both take them."""

from typing import NamedTuple

import numpy as np
import trimesh
from scipy import ndimage

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.implants.model import Mesh
from screwpose.implants.parametric import make_screw
from screwpose.simulation import CArm, carm_camera
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import ALUMINIUM, TITANIUM, WATER
from tests.validation.gvxr_reference import Piece

SIZE = (400, 320)
CAMERA = carm_camera(
    CArm(pixel_mm=0.5, image_size=SIZE),
    np.zeros(3),
    np.array([0.1, 1.0, 0.2]),
    np.array([0.02, 0.0, -1.0]),
    (3.3, -2.6),
)
# By atomic number: the composition of `screwpose.simulation.materials`, written down again.
TI_6AL_4V, AL, H2O = {22: 0.90, 13: 0.06, 23: 0.04}, {13: 1.0}, {1: 0.111898, 8: 0.888102}


class Scene(NamedTuple):
    """A scene for both simulators."""

    camera: Camera
    bodies: list[Body]
    pieces: list[Piece]


def ball(radius_mm: float, at_mm: tuple[float, float, float], subdivisions: int = 5) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return Mesh(np.asarray(made.vertices) + at_mm, np.asarray(made.faces, dtype=np.int64))


def screw_and_ball() -> Scene:
    """A titanium screw with its tower, and a titanium ball beside it, in air."""
    screw, beside = _screw(), ball(6.0, (38.0, 5.0, 20.0))
    return Scene(
        CAMERA,
        [Body(screw, TITANIUM), Body(beside, TITANIUM)],
        [Piece(screw, TI_6AL_4V, 4.43), Piece(beside, TI_6AL_4V, 4.43)],
    )


def nested() -> Scene:
    """The screw and a ball of aluminium within a ball of water of 250 mm."""
    screw, beside, water = _screw(), ball(12.0, (38.0, 5.0, 20.0)), ball(125.0, (0.0, 0.0, 0.0))
    return Scene(
        CAMERA,
        [
            Body(water, WATER, layer=Layer.MUSCLE),
            Body(screw, TITANIUM, layer=Layer.IMPLANT),
            Body(beside, ALUMINIUM, layer=Layer.INSTRUMENT),
        ],
        [Piece(water, H2O, 1.0, outer=True), Piece(screw, TI_6AL_4V, 4.43), Piece(beside, AL, 2.70)],
    )


def _screw() -> Mesh:
    screw = make_screw().mesh
    turn = trimesh.transformations.rotation_matrix(0.7, (1.0, 0.3, 0.2))[:3, :3]
    return Mesh((screw.vertices_mm - [0.0, 60.0, 0.0]) @ turn.T, screw.faces)


def off_edges(transmission: FloatArray) -> FloatArray:
    """Where the image has no edge within a pixel: its logarithm changes by less than a fifth over two pixels."""
    logarithm = np.log(np.maximum(transmission, 1e-9))
    spread = ndimage.maximum_filter(logarithm, 3) - ndimage.minimum_filter(logarithm, 3)
    return np.asarray(spread < 0.2)


def shift_px(image: FloatArray, other: FloatArray) -> FloatArray:
    """By how much (u, v) `other` lies beside `image`, by least squares of their difference on the gradient."""
    dv, du = np.gradient(image)
    slopes = np.column_stack([du.ravel(), dv.ravel()])
    return np.asarray(np.linalg.lstsq(slopes, (image - other).ravel(), rcond=None)[0])
