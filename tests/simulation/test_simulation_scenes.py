"""Two-screw cases: what is said about them is true of the images."""

import cv2
import numpy as np
import pytest

from screwpose._types import BoolArray, FloatArray
from screwpose.errors import ScrewposeError
from screwpose.geometry.camera import Camera
from screwpose.implants.design import ScrewDesign
from screwpose.implants.model import Implant
from screwpose.simulation import SimulatedCase, two_screw_scene

SMALL = (256, 256)
SEEDS = range(12)


@pytest.fixture(scope="module")
def bare() -> list[SimulatedCase]:
    """Metal in air, small images: quick, and nothing but the geometry."""
    return [two_screw_scene(seed, image_size=SMALL, with_anatomy=False) for seed in SEEDS]


def along_axis(implant: Implant, pose: FloatArray, fractions: FloatArray) -> FloatArray:
    """Points (N, 3) in the world, from the tip (0) to the centre (1) and on."""
    in_cad = implant.tip_mm + fractions[:, None] * (implant.center_mm - implant.tip_mm)
    return in_cad @ pose[:3, :3].T + pose[:3, 3]


def silhouette(camera: Camera, implant: Implant, pose: FloatArray) -> BoolArray:
    """Filled by OpenCV, triangle by triangle: another rasteriser than the simulator's."""
    assert camera.image_size is not None
    image = np.zeros(camera.image_size[::-1], dtype=np.uint8)
    corners = camera.project(implant.mesh.vertices_mm @ pose[:3, :3].T + pose[:3, 3])[implant.mesh.faces]
    for triangle in np.round(corners * 16).astype(np.int32):
        cv2.fillConvexPoly(image, triangle, 1, lineType=cv2.LINE_8, shift=4)
    return image.astype(bool)


def test_truth_is_where_the_metal_is(bare):
    for case in bare[:6]:
        for view in case.views.values():
            filled = np.zeros(SMALL[::-1], dtype=bool)
            for screw in case.screws:
                filled |= silhouette(view.camera, case.implants[screw.model], screw.world_from_cad)
            metal = (view.xray.transmission < 0.999).astype(np.uint8)
            # They may differ along the rim, by a pixel: what OpenCV fills is a little wider.
            rim = np.ones((3, 3), dtype=np.uint8)
            assert not (cv2.erode(metal, rim).astype(bool) & ~filled).any()
            assert not (filled & ~cv2.dilate(metal, rim).astype(bool)).any()
            assert 500 < filled.sum() < 0.5 * filled.size


def test_truth_lies_on_dark_pixels_of_the_patients_images():
    case = two_screw_scene(9)
    for view in case.views.values():
        assert view.xray.pixels.shape == (1024, 1024)
        assert view.xray.pixels.dtype == np.uint8
        pixels = cv2.GaussianBlur(view.xray.pixels.astype(np.float64), (0, 0), 1.5)
        for screw in case.screws:
            points = along_axis(case.implants[screw.model], screw.world_from_cad, np.linspace(0.2, 1.6, 15))
            u, v = np.round(view.camera.project(points)).astype(int).T
            course = np.array([u[-1] - u[0], v[-1] - v[0]], dtype=float)
            aside = 40.0 * np.array([-course[1], course[0]]) / np.linalg.norm(course)
            beside = [np.round(np.array([u, v]) + sign * aside[:, None]).astype(int) for sign in (1.0, -1.0)]
            on_screw = pixels[v, u]
            assert all(np.mean(on_screw < pixels[b[1], b[0]] - 12.0) > 0.9 for b in beside)


def test_same_seed_same_bytes():
    first, again, other = (two_screw_scene(seed, image_size=(128, 128)) for seed in (7, 7, 8))
    for name, view in first.views.items():
        assert view.xray.pixels.tobytes() == again.views[name].xray.pixels.tobytes()
        assert view.camera.projection.tobytes() == again.views[name].camera.projection.tobytes()
        assert view.xray.pixels.tobytes() != other.views[name].xray.pixels.tobytes()
    for name, marks in first.annotations.items():
        for mark, mark_again in zip(marks, again.annotations[name], strict=True):
            assert mark.label == mark_again.label
            np.testing.assert_array_equal(mark.tip_px, mark_again.tip_px)
            np.testing.assert_array_equal(mark.center_px, mark_again.center_px)


def test_options_leave_the_geometry_alone(bare):
    """Size of the image, anatomy and noise of the marks do not move the screws: strata can be compared case by case."""
    other = two_screw_scene(3, image_size=(64, 64), landmark_noise_px=0.0)
    for screw, same in zip(bare[3].screws, other.screws, strict=True):
        np.testing.assert_array_equal(screw.world_from_cad, same.world_from_cad)
    corners = []
    for name, view in other.views.items():
        source = bare[3].views[name].camera.center_in_world_mm
        np.testing.assert_allclose(view.camera.center_in_world_mm, source, atol=1e-6)
        # The same detector: its corners are where they were, half a pixel outside the corner pixels' centres.
        for camera, size in ((view.camera, 64), (bare[3].views[name].camera, 256)):
            corners.append(camera.ray_directions_in_world(np.array([[-0.5, -0.5], [size - 0.5, size - 0.5]])))
    np.testing.assert_allclose(corners[0::2], corners[1::2], atol=1e-9)


def test_marks_have_the_noise_asked_for(bare):
    residuals = []
    for case in bare:
        for screw in case.screws:
            points = along_axis(case.implants[screw.model], screw.world_from_cad, np.array([0.0, 1.0]))
            for name, label in screw.labels.items():
                mark = next(mark for mark in case.annotations[name] if mark.label == label)
                residuals.append(np.stack([mark.tip_px, mark.center_px]) - case.views[name].camera.project(points))
    residual = np.concatenate(residuals)
    assert residual.shape == (96, 2)
    # 192 numbers: the standard deviation is known to 5 %, the mean to 0.11 px.
    assert residual.std() == pytest.approx(1.5, rel=0.15)
    assert np.abs(residual.mean(axis=0)).max() < 0.45


def test_without_noise_marks_are_exact():
    case = two_screw_scene(1, image_size=(64, 64), with_anatomy=False, landmark_noise_px=0.0)
    for screw in case.screws:
        points = along_axis(case.implants[screw.model], screw.world_from_cad, np.array([0.0, 1.0]))
        mark = next(mark for mark in case.annotations["LAT"] if mark.label == screw.labels["LAT"])
        np.testing.assert_allclose(
            np.stack([mark.tip_px, mark.center_px]), case.views["LAT"].camera.project(points), atol=1e-9
        )


def test_labels_of_one_view_say_nothing_about_the_other(bare):
    for case in bare:
        assert [mark.label for mark in case.annotations["AP"]] == ["1", "2"]
        assert [mark.label for mark in case.annotations["LAT"]] == ["a", "b"]
        assert {screw.labels["AP"] for screw in case.screws} == {"1", "2"}
        assert {screw.labels["LAT"] for screw in case.screws} == {"a", "b"}
    straight = sum(any(screw.labels == {"AP": "1", "LAT": "a"} for screw in case.screws) for case in bare)
    assert 2 <= straight <= 10
    # Nor does the order in which the truth lists them.
    assert 2 <= sum(case.screws[0].labels["AP"] == "1" for case in bare) <= 10


def test_views_are_those_of_a_c_arm(bare):
    for case in bare:
        ap, lat = case.views["AP"].camera, case.views["LAT"].camera
        between = np.degrees(np.arccos(ap.viewing_axis_in_world @ lat.viewing_axis_in_world))
        assert 82.0 < between < 98.0
        for camera in (ap, lat):
            assert camera.is_right_handed
            focal_mm = camera.intrinsics[0, 0] * 1.2  # 1024 pixels of 0.3 mm are 256 of 1.2 mm
            assert 980.0 < focal_mm < 1020.0
            assert camera.intrinsics[0, 0] == pytest.approx(camera.intrinsics[1, 1])
            assert 600.0 < np.linalg.norm(camera.center_in_world_mm - [0.0, 45.0, 5.0]) < 700.0
            assert np.abs(camera.intrinsics[:2, 2] - 127.5).max() < 5.0
        assert ap.viewing_axis_in_world[1] > 0.95  # from front to back
        assert ap.camera_from_world[1, 2] < -0.9  # the patient's head is up


def test_screws_converge_towards_the_middle_and_towers_stand_backwards(bare):
    for case in bare:
        lines = [along_axis(case.implants[s.model], s.world_from_cad, np.array([0.0, 1.0, 4.0])) for s in case.screws]
        for tip, center, tower in lines:
            assert tower[1] > center[1] + 40.0 > tip[1] + 50.0
            axis = (center - tip) / np.linalg.norm(center - tip)
            convergence = np.degrees(np.arcsin(axis[0] * np.sign(center[0])))
            assert 9.0 < convergence < 31.0
            assert np.abs(center[0]) > np.abs(tip[0])
        for view in case.views.values():
            for line in lines:
                pixels = view.camera.project(line[:2])
                assert ((pixels > 4.0) & (pixels < 251.0)).all()


def test_overlaps_in_lat_span_partial_to_complete(bare):
    overlaps = np.array([case.overlap["LAT"] for case in bare])
    assert overlaps.min() >= 0.05
    assert np.count_nonzero(overlaps < 0.5) >= 2
    assert np.count_nonzero(overlaps > 0.75) >= 2
    case = bare[int(np.argmax(overlaps))]
    masks = [silhouette(case.views["LAT"].camera, case.implants[s.model], s.world_from_cad) for s in case.screws]
    want = (masks[0] & masks[1]).sum() / min(mask.sum() for mask in masks)
    assert overlaps.max() == pytest.approx(want, abs=0.05)


def test_designs_can_be_chosen():
    designs = (ScrewDesign(shank_diameter_mm=5.5, shank_length_mm=40.0), ScrewDesign(tower_length_mm=80.0))
    case = two_screw_scene(4, image_size=(64, 64), with_anatomy=False, designs=designs)
    assert list(case.implants) == ["ms55x40", "ms65x45"]
    assert {screw.model for screw in case.screws} == {"ms55x40", "ms65x45"}
    assert case.implants["ms55x40"].length_mm == pytest.approx(20.0)
    alike = (ScrewDesign(), ScrewDesign(tower_length_mm=80.0))
    assert list(two_screw_scene(4, image_size=(64, 64), with_anatomy=False, designs=alike).implants) == [
        "ms65x45",
        "ms65x45b",
    ]


def test_screws_that_do_not_fit_are_refused():
    with pytest.raises(ScrewposeError, match=r"no arrangement of 2 screws .*: tips or centres are out of the field"):
        two_screw_scene(0, image_size=(256, 12), with_anatomy=False)
