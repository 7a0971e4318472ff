"""Two screws that overlap in two small views, drawn by the simulator's path lengths: other code than the solver's."""

import numpy as np
from scipy.ndimage import gaussian_filter

from screwpose.geometry import Camera, rigid
from screwpose.implants import Implant, ScrewDesign, make_screw
from screwpose.registration.landmark_prior import MarkedScrew
from screwpose.registration.thickness_fit import Body
from screwpose.similarity.thickness import GradientTarget, make_gradient_target
from screwpose.simulation.pathlength import path_length_mm

SIZE = (300, 300)
K = np.array([[1300.0, 0, 149.5], [0, 1300.0, 149.5], [0, 0, 1]])
CAMERAS = [
    Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 600]]), SIZE),
    Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 600]]), SIZE),
]
SCREW = make_screw(ScrewDesign(segments=16, slot_lengths_mm=(30.0, 20.0), tower_length_mm=45.0))


def pose_at(turn: list[float], shift: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.array(turn))
    pose[:3, 3] = shift
    return pose


POSE = pose_at([0.25, 0.3, 0.15], [-5.0, -45.0, -10.0])
BESIDE = pose_at([0.2, 0.4, 0.1], [3.0, -40.0, 5.0])  # overlaps the other in both views


def drawn(
    implant: Implant, poses: list[np.ndarray], noise: float, seed: int, is_sharp: bool = True, blur_px: float = 0.0
) -> list[GradientTarget]:
    """Views of all of them, by a detector that blurs by so much."""
    rng = np.random.default_rng(seed)
    made = []
    filters = (0.7, 5, True) if is_sharp else (1.3, 0, False)
    for camera in CAMERAS:
        lengths = sum(
            path_length_mm(camera, rigid.transform(pose, implant.mesh.vertices_mm)[implant.mesh.faces], SIZE)
            for pose in poses
        )
        image = 0.8 * -np.expm1(-0.22 * np.asarray(lengths))
        image = gaussian_filter(image, blur_px) + rng.normal(0, noise, SIZE)
        made.append(make_gradient_target(image.astype(np.float32), np.ones(SIZE, bool), camera, 1, *filters))
    return made


def body(implant: Implant, pose: np.ndarray) -> Body:
    ends = [camera.project(rigid.transform(pose, np.stack([implant.tip_mm, implant.center_mm]))) for camera in CAMERAS]
    marks = MarkedScrew(CAMERAS, np.stack([one[0] for one in ends]), np.stack([one[1] for one in ends]))
    return Body(implant, implant.mesh, marks)
