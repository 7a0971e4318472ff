"""Cases of landmarks alone: two C-arm views and screws whose pairing is known. No image is rendered."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from screwpose.files.case import Annotation, Case, View
from screwpose.geometry import Camera
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant, Mesh

K = np.array([[3333.0, 0, 511.5], [0, 3333.0, 511.5], [0, 0, 1]])
SCREW = Implant("screw", Mesh(np.eye(3), np.array([[0, 1, 2]])), np.zeros(3), np.array([0, 22.5, 0]))
_BLANK = Radiograph(np.zeros((1024, 1024), np.float32))
_EVERYWHERE = np.ones((1024, 1024), bool)


def camera(angle_deg: float, tilt_deg: float = 0.0) -> Camera:
    """A C-arm view of the world's origin, turned about y, then tilted: 650 mm from the source."""
    R = Rotation.from_euler("yx", [angle_deg, tilt_deg], degrees=True).as_matrix()
    return Camera.from_matrix(K @ np.column_stack([R, [0, 0, 650.0]]), (1024, 1024))


def screws(rng: np.random.Generator, count: int) -> np.ndarray:
    """Tips and centres (count, 2, 3), mm: spread over some levels, converging, 22.5 mm from tip to centre."""
    tips = rng.uniform([-30, -15, -25], [30, 15, 25], (count, 3)) + np.arange(count)[:, None] // 2 * [0, 30.0, 0]
    axes = rng.normal(size=(count, 3)) * 0.25 + [0, 0, 1.0]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.stack([tips, tips + 22.5 * axes], axis=1)


def case_of(
    ends_mm: np.ndarray,
    cameras: dict[str, Camera],
    noise_px: float = 0.0,
    rng: np.random.Generator | None = None,
    orders: dict[str, list[int]] | None = None,
    implant: Implant = SCREW,
) -> Case:
    """A case whose label in each view is the true screw's number; `orders` says which are marked, in which order."""
    rng = rng or np.random.default_rng(0)
    annotations = {}
    for name, view in cameras.items():
        order = (orders or {}).get(name, list(range(len(ends_mm))))
        marks = [view.project(ends_mm[i]) + rng.normal(0, 1, (2, 2)) * noise_px for i in order]
        annotations[name] = tuple(
            Annotation(f"{name}{i}", mark[0], mark[1]) for i, mark in zip(order, marks, strict=True)
        )
    views = {name: View(name, view, _BLANK, _EVERYWHERE) for name, view in cameras.items()}
    return Case("landmarks", views, {implant.name: implant}, annotations, path=Path("case.json"))
