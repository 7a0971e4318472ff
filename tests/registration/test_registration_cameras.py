"""Poses and cameras together, on images by the simulator's own path lengths: what a rod sees comes back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from screwpose.geometry import Camera, rigid
from screwpose.geometry.correction import CameraCorrection, CameraSigma
from screwpose.registration.alternatives import thread_lead_mm
from screwpose.registration.camera_fit import (
    CalibratedView,
    CameraState,
    camera_system,
    corrected_target,
    fit_cameras_at_scale,
)
from screwpose.registration.camera_recipe import (
    end_with_cameras,
    fit_with_cameras,
    turned_in_cameras,
    with_exact_cameras,
)
from screwpose.registration.camera_view import view_system, view_system_in_numpy
from screwpose.registration.landmark_prior import MarkedScrew
from screwpose.registration.recipe import scaled_stages
from screwpose.registration.thickness_fit import Body, changed
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientTarget, make_gradient_target
from screwpose.simulation.pathlength import path_length_mm
from tests.registration.test_registration_thickness import CAMERAS, SCREW, SIZE, TRUTH

PIVOT = np.mean([rigid.transform(pose, SCREW.center_mm) for pose in TRUTH], axis=0)
SIGMA = CameraSigma(1.0, 2.0, 0.5, 3.0)
WRONG = CameraCorrection.from_parameters(np.array([0.006, -0.008, 0.007, 1.0, -1.2, 0.8, 0.003, 2.0, -1.5]))
REPORTED = [CAMERAS["AP"], WRONG.applied(CAMERAS["LAT"], PIVOT)]
UNTOUCHED = CameraCorrection()
LEAD_MM = thread_lead_mm(SCREW, SCREW.mesh)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    made = []
    for camera in CAMERAS.values():
        parts = np.array([[3.0, 0.0, 1.0], [0.0, 3.0, 1.0], [0.0, 0.0, 1.0]])  # of a pixel, by each of which rays go
        size = (3 * SIZE[0], 3 * SIZE[1])
        finer = Camera(parts @ camera.projection, size)
        lengths = sum(
            path_length_mm(finer, rigid.transform(pose, SCREW.mesh.vertices_mm)[SCREW.mesh.faces], size)
            for pose in TRUTH
        )
        through = np.exp(-0.22 * np.asarray(lengths)).reshape(SIZE[1], 3, SIZE[0], 3).mean(axis=(1, 3))
        lit = gaussian_filter(through, 0.8) + 0.02
        made.append((-np.log(lit) / 4.4 + rng.normal(0, 0.004, SIZE)).astype(np.float32))
    return made


def targets_of(images: list[np.ndarray], cameras: list[Camera], scale: int) -> list[GradientTarget]:
    return [
        make_gradient_target(image, np.ones(SIZE, bool), camera, scale)
        for image, camera in zip(images, cameras, strict=True)
    ]


def bodies_in(cameras: list[Camera], noise_px: float = 0.5) -> list[Body]:
    rng = np.random.default_rng(8)
    made = []
    for pose in TRUTH:
        ends = rigid.transform(pose, np.stack([SCREW.tip_mm, SCREW.center_mm]))
        marks = [camera.project(ends) + noise_px * rng.normal(size=(2, 2)) for camera in CAMERAS.values()]
        marked = MarkedScrew(cameras, np.stack([m[0] for m in marks]), np.stack([m[1] for m in marks]))
        made.append(Body(SCREW, SCREW.mesh, marked))
    return made


def state_at(poses: list[np.ndarray], correction: CameraCorrection = UNTOUCHED) -> CameraState:
    return CameraState(tuple(poses), (UNTOUCHED, correction), (Blur(), Blur()))


def relation(poses: tuple[np.ndarray, ...]) -> tuple[float, float]:
    """Distance of the heads, mm, and angle of the axes, degrees."""
    heads = [rigid.transform(pose, SCREW.center_mm + (SCREW.center_mm - SCREW.tip_mm)) for pose in poses]
    axes = [pose[:3, :3] @ SCREW.axis for pose in poses]
    return float(np.linalg.norm(heads[0] - heads[1])), float(np.degrees(rigid.angle_between_rad(*axes)))


def test_cameras_that_are_wrong_cost_the_relation_when_held_and_not_when_free(images: list[np.ndarray]) -> None:
    bodies = bodies_in(REPORTED)
    start = [
        changed(body, pose, np.array([0.02, -0.02, 0.02, 0.5, -0.5, 0.5]))
        for body, pose in zip(bodies, TRUTH, strict=True)
    ]
    views = [CalibratedView(camera, SIGMA) for camera in REPORTED]
    stages = scaled_stages(0.46)
    targets = {scale: targets_of(images, REPORTED, scale) for scale, _ in stages}
    told: list[float] = []
    fits = []
    for own in (with_exact_cameras(views), views):
        told.clear()
        begun = fit_with_cameras(
            bodies, [state_at(start)], targets, stages, own, PIVOT, lambda fraction, _: told.append(fraction)
        )
        state, _ = turned_in_cameras(bodies, begun.state, [LEAD_MM] * len(bodies), targets, stages, own, PIVOT)
        fits.append(end_with_cameras(bodies, state, targets, stages, targets[1], own, PIVOT))
    held, free = fits
    off = [np.abs(np.subtract(relation(fit.state.world_from_cad), relation(tuple(TRUTH)))) for fit in (held, free)]
    assert off[1][0] < 0.03  # a pixel is 0.46 mm here
    assert off[1][1] < 0.05
    assert np.mean(free.system.energies) > 0.99 > np.mean(held.system.energies) + 0.1
    for camera, view in zip(held.state.corrected(views, PIVOT), views, strict=True):
        np.testing.assert_allclose(camera.projection, view.camera.projection)
    assert told == sorted(told)
    assert told[0] == 0.0
    # Of two equally uncertain poses the screws hold the difference, and nothing holds the sum: 1 / sqrt(2) is left.
    np.testing.assert_allclose(free.system.left[:, :6], np.sqrt(0.5), atol=0.01)
    np.testing.assert_allclose(held.system.left, 1.0)


@pytest.mark.parametrize("scale", [1, 2])
def test_each_parameter_of_a_camera_finds_its_way_back(images: list[np.ndarray], scale: int) -> None:
    """One by one, all else right: a step of Newton in one unknown, the Jacobian's column against the images."""
    cameras = list(CAMERAS.values())
    bodies = [replace(body, marks=None) for body in bodies_in(cameras)]
    vague = CameraSigma(100.0, 100.0, 100.0, 100.0)  # priors that play no part
    views = [CalibratedView(camera, vague) for camera in cameras]
    targets = targets_of(images, cameras, scale)
    held = with_exact_cameras(views)
    settled = fit_cameras_at_scale(targets, held, bodies, state_at(TRUTH), PIVOT, 3.0, 8, 1e-4).state
    for k, step in enumerate([0.002, 0.002, 0.002, 1.5, 0.15, 0.15, 0.002, 0.3, 0.3]):
        own = np.zeros(9)
        own[k] = step
        found = []
        for sign in (1.0, -1.0):
            moved = replace(settled, corrections=(UNTOUCHED, settled.corrections[1].then(sign * own)))
            system = camera_system(targets, views, bodies, moved, PIVOT, 3.0)
            place = (6 * len(bodies) + len(system.gradient)) // 2 + k  # the second of two views
            found.append(system.gradient[place] / system.information[place, place] * vague.by_parameter[k])
        assert (0.5 if scale == 1 else 0.3) < (found[1] - found[0]) / (2.0 * step) < 1.3, k  # faces seen edge-on


@pytest.mark.parametrize(("scale", "blur_px", "mean_px"), [(1, 1.3, 0), (2, 1.3, 0), (1, 0.7, 21)])
def test_the_compiled_loops_are_the_reference(
    images: list[np.ndarray], scale: int, blur_px: float, mean_px: int
) -> None:
    target = make_gradient_target(images[1], np.ones(SIZE, bool), REPORTED[1], scale, blur_px, mean_px)
    bodies, blur = bodies_in(REPORTED), Blur(1.0, 0.25, 0.4, -0.1)
    expected = view_system_in_numpy(target, bodies, TRUTH, blur)
    found = view_system(target, bodies, TRUTH, blur)
    assert 0.3 < expected.energy < 0.999  # P is wrong
    np.testing.assert_allclose(found.energy, expected.energy, atol=1e-3)
    size = np.sqrt(np.diag(expected.information))
    motions = slice(0, 6 * len(bodies))
    each = np.outer(size, size)
    off = (found.information - expected.information) / each
    assert np.abs(off[motions, motions]).max() < 0.01
    assert np.abs(off).max() < 0.2  # blur and intrinsics differ a little: see the loops
    assert (
        np.abs((found.gradient - expected.gradient) / size)[motions].max()
        < 0.01 * np.abs(expected.gradient / size).max()
    )
    other = view_system(target, bodies, TRUTH, replace(blur, edge_px=0.3))
    assert abs(other.energy - expected.energy) > 1e-3  # it can show a fault


def test_a_mirrored_view_gives_the_same_answer(images: list[np.ndarray]) -> None:
    mirror = np.array([[-1.0, 0.0, SIZE[0] - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    turned = [REPORTED[0], Camera(mirror @ REPORTED[1].projection, SIZE)]
    flipped = [images[0], images[1][:, ::-1]]
    corrections = []
    for cameras, pixels in ((REPORTED, images), (turned, flipped)):
        bodies = [replace(body, marks=None) for body in bodies_in(cameras)]
        views = [CalibratedView(camera, SIGMA) for camera in cameras]
        fit = fit_cameras_at_scale(targets_of(pixels, cameras, 2), views, bodies, state_at(TRUTH), PIVOT, 3.0, 3, 0.0)
        corrections.append(fit.state.corrections[1].parameters)
    corrections[1][7] *= -1.0
    assert np.abs(corrections[0][7]) > 0.01
    np.testing.assert_allclose(corrections[1], corrections[0], rtol=1e-3, atol=1e-4)


def test_the_corrected_target_has_the_corrected_camera(images: list[np.ndarray]) -> None:
    for scale in (1, 2):
        target = targets_of(images, REPORTED, scale)[1]
        corrected = corrected_target(target, REPORTED[1], WRONG, PIVOT)
        again = make_gradient_target(images[1], np.ones(SIZE, bool), WRONG.applied(REPORTED[1], PIVOT), scale)
        np.testing.assert_allclose(corrected.intrinsics, again.intrinsics, atol=1e-7)
        np.testing.assert_allclose(corrected.camera_from_world, again.camera_from_world, atol=1e-7)


def test_a_view_without_the_screws_says_nothing(images: list[np.ndarray]) -> None:
    target = targets_of(images, list(CAMERAS.values()), 1)[0]
    away = [pose.copy() for pose in TRUTH]
    for pose in away:
        pose[0, 3] += 500.0
    found = view_system(target, bodies_in(list(CAMERAS.values())), away, Blur())
    assert found.energy == 0.0
    assert not found.information.any()
