"""CT volumes in the beam against closed forms, and a real one."""

import builtins

import nibabel
import numpy as np
import pytest
import trimesh

from screwpose._types import FloatArray
from screwpose.errors import ImageError, ScrewposeError
from screwpose.implants.model import Mesh
from screwpose.simulation import CArm, CtVolume, carm_camera, read_ct, transmission
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import CORTICAL_BONE, FAT, MUSCLE, TITANIUM, WATER, energy_bins
from screwpose.simulation.rays import material_lengths_mm
from screwpose.simulation.volume import hounsfield_units, two_materials
from tests.data import shared_data

SIZE = (100, 80)
AP = carm_camera(
    CArm(pixel_mm=3.0, image_size=SIZE), np.zeros(3), np.array([0.1, 1.0, -0.05]), np.array([0.0, 0.0, -1.0])
)
MUSCLE_HU, BONE_HU = hounsfield_units(MUSCLE), hounsfield_units(CORTICAL_BONE)


def world_from_voxel(spacing_mm: float, shape: tuple[int, int, int]) -> FloatArray:
    """Axes along the world's, the volume's middle in the origin."""
    pose = np.diag([spacing_mm] * 3 + [1.0])
    pose[:3, 3] = -0.5 * spacing_mm * (np.array(shape) - 1)
    return pose


def rays() -> tuple[FloatArray, FloatArray]:
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    return AP.center_in_world_mm, AP.ray_directions_in_world(pixels)


def box_span(half_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where each pixel's ray enters and leaves a box about the origin, mm from the source."""
    source, directions = rays()
    with np.errstate(divide="ignore"):
        one, two = (-half_mm - source) / directions, (half_mm - source) / directions
    near, far = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return near.reshape(SIZE[::-1]), np.maximum(far, near).reshape(SIZE[::-1])


def metal_box(size_mm: float) -> Body:
    made = trimesh.creation.box((size_mm,) * 3)
    cube = Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))
    return Body(cube, TITANIUM, layer=Layer.IMPLANT)


def test_even_volume_is_its_chord():
    """Between its outermost voxels' centres the volume is a box of muscle."""
    shape = (31, 21, 41)
    volume = CtVolume(np.full(shape, MUSCLE_HU, dtype=np.float32), world_from_voxel(3.0, shape))
    near, far = box_span(np.array([45.0, 30.0, 60.0]))
    got = material_lengths_mm(AP, [], SIZE, volume=volume)
    np.testing.assert_allclose(got["muscle"], far - near, rtol=1e-5, atol=1e-4)
    assert not got["cortical bone"].any()
    assert (far - near).max() > 60.0


def test_a_density_that_is_linear_in_space_is_integrated_exactly():
    """A field linear in x, y and z is trilinear as it is: its integral is the chord times its value in the middle."""
    shape = (31, 21, 41)
    pose = world_from_voxel(3.0, shape)
    i, j, k = np.indices(shape)
    share = 0.3 + 0.008 * i + 0.006 * j + 0.004 * k
    hu = MUSCLE_HU + share * (BONE_HU - MUSCLE_HU)
    assert share.max() < 1.0
    got = material_lengths_mm(AP, [], SIZE, volume=CtVolume(hu.astype(np.float32), pose))
    near, far = box_span(np.array([45.0, 30.0, 60.0]))
    source, directions = rays()
    middle = source + (0.5 * (near + far)).reshape(-1, 1) * directions
    voxel = (middle - pose[:3, 3]) / 3.0
    in_middle = (0.3 + voxel @ [0.008, 0.006, 0.004]).reshape(SIZE[::-1])
    np.testing.assert_allclose(got["cortical bone"], in_middle * (far - near), rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(got["muscle"], (1.0 - in_middle) * (far - near), rtol=1e-4, atol=1e-3)


def test_a_gaussian_in_a_turned_volume():
    """The line integral of a Gaussian is another: peak * sqrt(2 pi) * sigma * exp(-d^2 / 2 sigma^2)."""
    shape, sigma = (61, 51, 71), 16.0
    turn = trimesh.transformations.rotation_matrix(0.6, (0.3, -0.5, 0.8))
    pose = turn @ np.diag([2.0, 2.5, 1.8, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ (0.5 * (np.array(shape) - 1))
    at = np.moveaxis(np.indices(shape), 0, -1) @ pose[:3, :3].T + pose[:3, 3]
    share = 0.9 * np.exp(-0.5 * np.sum(at**2, axis=-1) / sigma**2)
    hu = MUSCLE_HU + share * (BONE_HU - MUSCLE_HU)
    got = material_lengths_mm(AP, [], SIZE, volume=CtVolume(hu.astype(np.float32), pose))["cortical bone"]
    source, directions = rays()
    distance = np.linalg.norm(np.cross(directions, -source), axis=1).reshape(SIZE[::-1])
    want = 0.9 * np.sqrt(2.0 * np.pi) * sigma * np.exp(-0.5 * distance**2 / sigma**2)
    near = distance < 25.0  # further out the volume ends before the Gaussian does
    np.testing.assert_allclose(got[near], want[near], rtol=0.01)
    assert np.count_nonzero(near) > 200


@pytest.mark.parametrize("supersample", [1, 3])
def test_a_body_takes_the_volume_s_place(supersample):
    shape = (41, 31, 41)
    volume = CtVolume(np.full(shape, MUSCLE_HU, dtype=np.float32), world_from_voxel(3.0, shape))
    alone = material_lengths_mm(AP, [], SIZE, volume=volume)["muscle"]
    got = material_lengths_mm(AP, [metal_box(20.0)], SIZE, supersample, volume=volume)
    np.testing.assert_allclose(got["muscle"] + got["titanium"], alone, atol=0.02)
    assert got["titanium"].max() > 19.0
    cavity = Body(metal_box(20.0).mesh, FAT, layer=Layer.FAT, sharp=False)
    in_fat = material_lengths_mm(AP, [cavity], SIZE, volume=volume)
    np.testing.assert_allclose(in_fat["muscle"] + in_fat["fat"], alone, atol=0.02)


def test_transmission_through_a_volume_obeys_beer_and_lambert():
    shape = (41, 31, 41)
    volume = CtVolume(np.full(shape, MUSCLE_HU, dtype=np.float32), world_from_voxel(3.0, shape))
    bins = energy_bins(90.0)
    _, directions = rays()
    cosine = directions.reshape(*SIZE[::-1], 3)[40, 50, 1]
    want = bins.weights @ np.exp(-MUSCLE.attenuation_per_mm_in(bins) * 90.0 / cosine)
    assert transmission(AP, [], SIZE, volume=volume)[40, 50] == pytest.approx(want, rel=1e-4)


def test_two_materials_by_hand():
    """Air, water-like fat, muscle, half bone, bone, and what is denser."""
    soft, bone = two_materials(np.array([-1000.0, -500.0, MUSCLE_HU, 0.5 * (MUSCLE_HU + BONE_HU), BONE_HU, 3000.0]))
    np.testing.assert_allclose(soft[:5], [0.0, 500.0 / (1000.0 + MUSCLE_HU), 1.0, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(bone[:5], [0.0, 0.0, 0.0, 0.5, 1.0], atol=1e-12)
    assert soft[5] == 0.0
    assert bone[5] > 1.5


def test_hounsfield_units_are_those_of_tissue():
    """By definition for water; textbooks have 40 to 70 for muscle, -70 to -110 for fat, and 1000 and up for cortex."""
    assert hounsfield_units(WATER) == 0.0
    assert 40.0 < MUSCLE_HU < 70.0
    assert -120.0 < hounsfield_units(FAT) < -60.0
    assert 1200.0 < BONE_HU < 2000.0


def test_nifti_is_turned_from_ras_to_lps(tmp_path):
    affine = np.array([[2.0, 0.0, 0.0, -10.0], [0.0, 3.0, 0.0, 20.0], [0.0, 0.0, 4.0, 5.0], [0.0, 0.0, 0.0, 1.0]])
    hu = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    nibabel.save(nibabel.Nifti1Image(hu, affine), tmp_path / "ct.nii.gz")
    volume = read_ct(tmp_path / "ct.nii.gz")
    np.testing.assert_array_equal(volume.hu, hu)
    # Voxel (1, 0, 2) lies at R = 2 - 10, A = 20, S = 13: that is 8 mm to the left, 20 to the front.
    np.testing.assert_allclose(volume.world_from_voxel @ [1.0, 0.0, 2.0, 1.0], [8.0, -20.0, 13.0, 1.0])


def test_the_real_ct_shows_a_spine():
    """Thorax to pelvis: a patient's thickness of soft tissue, bone in the middle, and less beside it."""
    volume = read_ct(shared_data("ct/example_ct.nii.gz"))
    center = (volume.world_from_voxel @ [*(0.5 * (np.array(volume.hu.shape) - 1)), 1.0])[:3]
    view = carm_camera(
        CArm(pixel_mm=3.0, image_size=SIZE), center, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    )
    got = material_lengths_mm(view, [], SIZE, volume=volume)
    middle = (slice(25, 55), slice(30, 70))
    assert 120.0 < np.median(got["muscle"][middle]) < 320.0
    assert 4.0 < np.percentile(got["cortical bone"][middle], 95) < 60.0
    # No ray meets more bone than the column of voxels that has most of it, but for its slant.
    total = (volume.lengths_per_mm.sum(axis=1) * np.linalg.norm(volume.world_from_voxel[:3, 1])).max(axis=(0, 1))
    assert got["cortical bone"].max() < 1.2 * total[1]
    seen = transmission(view, [], SIZE, volume=volume)
    assert 0.001 < np.median(seen[middle]) < 0.05


@pytest.mark.parametrize(
    ("write", "text"),
    [
        (lambda _: None, r"ct\.nii\.gz: there is no such file; expected a CT volume as NIfTI"),
        (lambda path: path.write_bytes(b"no NIfTI"), r"ct\.nii\.gz: it cannot be read \(.*\); expected a CT volume"),
        (
            lambda path: nibabel.save(nibabel.Nifti1Image(np.zeros((4, 4), np.int16), np.eye(4)), path),
            r"ct\.nii\.gz: a CT volume of shape \(4, 4\); expected three axes",
        ),
        (
            lambda path: nibabel.save(nibabel.Nifti1Image(np.full((2, 2, 2), np.nan, np.float32), np.eye(4)), path),
            r"ct\.nii\.gz: 8 voxels of a CT volume are not finite; expected Hounsfield units",
        ),
    ],
    ids=["absent", "broken", "flat", "nan"],
)
def test_bad_files_are_refused(tmp_path, write, text):
    path = tmp_path / "ct.nii.gz"
    write(path)
    with pytest.raises(ImageError, match=text):
        read_ct(path)


def test_a_file_cut_short_is_refused(tmp_path):
    path = tmp_path / "ct.nii.gz"
    noise = np.random.default_rng(0).integers(-1000, 1000, (40, 40, 40)).astype(np.int16)
    nibabel.save(nibabel.Nifti1Image(noise, np.eye(4)), path)
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(ImageError, match=r"ct\.nii\.gz: it cannot be read"):
        read_ct(path)


def test_a_file_in_metres_is_refused(tmp_path):
    image = nibabel.Nifti1Image(np.zeros((2, 2, 2), np.int16), np.eye(4))
    image.header.set_xyzt_units("meter")
    nibabel.save(image, tmp_path / "ct.nii")
    with pytest.raises(ImageError, match=r"ct\.nii: its unit is meter; expected a CT volume as NIfTI .* in mm"):
        read_ct(tmp_path / "ct.nii")


def test_a_volume_without_an_inverse_is_refused():
    with pytest.raises(ImageError, match="whose world_from_voxel has no inverse; expected an affine map"):
        CtVolume(np.zeros((2, 2, 2), np.float32), np.diag([1.0, 0.0, 1.0, 1.0]))


def test_without_nibabel_the_extra_is_named(tmp_path, monkeypatch):
    real_import = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "nibabel":
            raise ImportError("No module named 'nibabel'")
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ScrewposeError, match=r"nibabel, which is not installed.*pip install 'screwpose\[ct\]'"):
        read_ct(tmp_path / "ct.nii.gz")
