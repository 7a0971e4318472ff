"""A good case is read as it is; warnings do not stop it; the sign of P is settled by the annotations."""

import json
import re
import shutil

import numpy as np
import pytest

from screwpose.errors import CalibrationError
from screwpose.files import inspect_case, read_case
from tests.data import shared_data
from tests.files.builder import AP, LAT, CaseBuilder, K, box_stl


@pytest.fixture
def builder(tmp_path):
    return CaseBuilder(tmp_path / "case")


def test_a_good_case_has_no_findings(builder):
    case, findings = inspect_case(builder.write())
    assert [str(finding) for finding in findings] == []
    assert case is not None


def test_everything_of_the_case_is_there(builder):
    case = read_case(builder.write().parent)
    assert (case.id, list(case.views), case.path) == ("box", ["AP", "LAT"], builder.file)
    assert case.warnings == ()
    np.testing.assert_allclose(case.views["AP"].camera.center_in_world_mm, [0, 0, -800], atol=1e-9)
    np.testing.assert_allclose(case.views["LAT"].camera.center_in_world_mm, [-800, 0, 0], atol=1e-9)
    assert case.views["AP"].camera.image_size == (64, 64)
    # Metal is bright inside: the screw of `xray` was dark in the file.
    pixels = case.views["AP"].radiograph.pixels
    assert pixels[35, 31] > 0.9 > 0.6 > pixels[10, 10]
    assert case.views["AP"].mask.dtype == np.bool_
    assert case.views["AP"].target is None
    implant = case.implants["box"]
    np.testing.assert_allclose(implant.mesh.vertices_mm.max(axis=0), [3, 45, 3])
    np.testing.assert_allclose(implant.center_mm, [0, 22.5, 0])
    (screw,) = case.annotations["AP"]
    assert (screw.label, screw.model) == ("1", "box")
    np.testing.assert_allclose(screw.center_px, [31.5, 37.125])
    assert case.annotations["LAT"][0].model is None


def test_the_annotations_of_the_builder_are_where_the_cameras_say(builder):
    case = read_case(builder.write())
    for view, (screw,) in case.annotations.items():
        camera = case.views[view].camera
        np.testing.assert_allclose(camera.project(np.array([0.0, 22.5, 0.0])), screw.center_px, atol=1e-9)


def test_masks_and_targets_are_read(builder):
    mask = np.zeros((64, 64), dtype=np.uint8)
    mask[8:, :] = 1
    target = np.zeros((64, 64), dtype=np.uint8)
    target[32:44, 31:33] = 255
    builder.images |= {"mask.png": mask, "target.png": target}
    builder.view("AP").update({"mask": "mask.png", "target": "target.png"})
    builder.view("LAT").update({"mask": None, "target": None})
    case = read_case(builder.write())
    np.testing.assert_array_equal(case.views["AP"].mask, mask > 0)
    np.testing.assert_array_equal(case.views["AP"].target, target > 0)
    assert case.views["LAT"].target is None


def test_parts_and_pivot_are_read_in_the_unit_of_the_model(builder):
    builder.meshes = {
        "models/box.stl": box_stl([-0.3, 0, -0.3], [0.3, 4.5, 0.3]),
        "models/shank.stl": box_stl([-0.3, 0, -0.3], [0.3, 3, 0.3]),
        "models/tower.stl": box_stl([-0.3, 3, -0.3], [0.3, 4.5, 0.3]),
    }
    builder.data["models"]["box"] |= {
        "unit": "cm",
        "parts": [{"name": "shank", "mesh": "models/shank.stl"}, {"name": "tower", "mesh": "models/tower.stl"}],
        "pivot": [0, 30, 0],
    }
    implant = read_case(builder.write()).implants["box"]
    assert [part.name for part in implant.parts] == ["shank", "tower"]
    np.testing.assert_allclose(implant.parts[1].mesh.vertices_mm.min(axis=0), [-3, 30, -3])
    np.testing.assert_allclose(implant.pivot_mm, [0, 30, 0])


@pytest.mark.parametrize("factor", [2.5, -1.0, -1e-3])
def test_scale_and_sign_of_a_matrix_do_not_matter(builder, factor):
    builder.view("LAT")["projection"] = (factor * LAT).tolist()
    case, findings = inspect_case(builder.write())
    assert findings == ()
    np.testing.assert_allclose(case.views["LAT"].camera.projection, LAT, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_mirrored_matrix_is_taken_with_a_warning(builder, factor):
    """The image and its P stored mirrored left to right: u becomes 63 - u. Handedness cannot tell the sign any more."""
    mirror = np.array([[-1.0, 0.0, 63.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    builder.view("LAT")["projection"] = (factor * mirror @ LAT).tolist()
    case = read_case(builder.write())
    np.testing.assert_allclose(case.views["LAT"].camera.projection, mirror @ LAT, rtol=1e-9, atol=1e-9)
    assert case.views["LAT"].camera.depth_mm(np.zeros(3))[0] == pytest.approx(800.0)
    (warning,) = case.warnings
    assert warning.startswith("views.LAT.projection: the matrix mirrors the image")


def test_screws_behind_the_source_are_refused(builder):
    """A right-handed camera that has the world's origin 800 mm behind it, and both landmarks at the same pixels."""
    turned = K @ np.array([[0.0, 0.0, -1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, -800.0]])
    builder.view("LAT")["projection"] = turned.tolist()
    with pytest.raises(CalibrationError, match=r"views\.LAT\.projection: negative depth: .* 800 mm behind the X-ray"):
        read_case(builder.write())


def test_a_matrix_of_another_image_size_is_named_with_its_ratio(builder):
    """P for 128 x 128 px with integer pixel centres: u' = 2 u + 0.5."""
    doubled = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]]) @ AP
    builder.view("AP")["projection"] = doubled.tolist()
    case, findings = inspect_case(builder.write())
    assert case is not None
    assert "is the middle of an image 2 times as large as this one of 64 x 64 px" in str(findings[0])
    assert "calibrated for 128 x 128 px? Then multiply its first two rows by 0.5" in str(findings[0])


WARNINGS = {
    "landmark just outside": (
        lambda b: b.screw("AP")["center"].__setitem__(1, 66.0),
        r"annotations\.AP\[0\]\.center: \[31\.5, 66\] of screw 1 is 2\.5 px outside the image; "
        r"expected u from -0\.5 to 63\.5 and v from -0\.5 to 63\.5\. It is used as it is\.",
    ),
    "different numbers of screws": (
        lambda b: b.add_screw("AP"),
        r"annotations: the views show different numbers of screws: 2 in AP and 1 in LAT; .* stay unpaired\.",
    ),
    "one screw marked twice": (
        lambda b: (
            b.add_screw("AP", tip=b.screw("AP")["tip"], center=b.screw("AP")["center"]),
            b.add_screw("LAT"),
        ),
        r'annotations\.AP\[1\]: screw "1\+" is marked at the same place as "1"; .* marked twice\?',
    ),
    "principal point far away": (
        lambda b: b.view("AP").update(projection=(np.array([[1, 0, 150.0], [0, 1, 0], [0, 0, 1]]) @ AP).tolist()),
        r"views\.AP\.projection: the principal point is \[181\.5, 31\.5\], 2\.34 image sizes off the middle, which is "
        r"unusual for an image of 64 x 64 px\. Does the matrix belong to this image",
    ),
    "focal length absurd": (
        lambda b: b.view("AP").update(
            projection=(np.array([[100, 0, -31.5 * 99], [0, 100, -31.5 * 99], [0, 0, 1]]) @ AP).tolist()
        ),
        r"views\.AP\.projection: the focal length is 2e\+04 x 2e\+04 px, 312 times the image's width, which is unusual",
    ),
    "skew": (
        lambda b: b.view("AP").update(projection=(np.array([[1, 0.1, -3.15], [0, 1, 0], [0, 0, 1]]) @ AP).tolist()),
        r"views\.AP\.projection: the skew is 20 px, which is unusual",
    ),
    "unequal focal lengths": (
        lambda b: b.view("AP").update(projection=(np.array([[2, 0, -31.5], [0, 1, 0], [0, 0, 1]]) @ AP).tolist()),
        r"views\.AP\.projection: the focal lengths along u and v are 400 and 200 px, which is unusual",
    ),
    "model's centre off the mesh": (
        lambda b: b.data["models"]["box"].update(center=[0, 82.5, 0]),
        r"models\.box: The center ",
    ),
    "parts without pivot": (
        lambda b: b.data["models"]["box"].update(parts=[{"name": "all", "mesh": "models/box.stl"}]),
        r"models\.box\.pivot: the key is missing, and there are parts; expected the point about which they move",
    ),
    "parts that are not the whole": (
        lambda b: (
            b.meshes.update({"models/part.stl": box_stl([-3, 0, -3], [3, 30, 3])}),
            b.data["models"]["box"].update(parts=[{"name": "shank", "mesh": "models/part.stl"}], pivot=[0, 30, 0]),
        ),
        r"models\.box\.parts: the parts together and the whole mesh differ by up to 15 mm",
    ),
    "open mesh": (
        lambda b: b.meshes.update({"models/box.stl": b.meshes["models/box.stl"].replace("vertex 3", "vertex 4", 1)}),
        r"models\.box\.mesh: It is not closed",
    ),
    "grey image as three channels": (
        lambda b: b.images.update({"ap.png": np.repeat(b.images["ap.png"][:, :, None], 3, axis=2)}),
        r"views\.AP\.image: Three equal colour channels were read as grey\.",
    ),
}


@pytest.mark.parametrize("name", WARNINGS)
def test_what_is_doubtful_is_a_warning_and_the_case_is_read(builder, name):
    spoil, pattern = WARNINGS[name]
    spoil(builder)
    case, findings = inspect_case(builder.write())
    assert case is not None, [str(finding) for finding in findings]
    assert {finding.level for finding in findings} == {"warning"}
    texts = "\n".join(case.warnings)
    assert re.search(pattern, texts), texts
    assert str(builder.folder) not in texts  # a result travels: no places of this machine in it


def test_three_views_work(builder):
    oblique = np.array([[0.6, 0, -0.8], [0, 1, 0], [0.8, 0, 0.6]])
    builder.data["views"]["OBL"] = {
        "image": "obl.png",
        "projection": np.column_stack([AP[:, :3] @ oblique, AP[:, 3]]).tolist(),
    }
    builder.images["obl.png"] = builder.images["ap.png"][:, ::-1].copy()
    builder.data["annotations"]["OBL"] = [{"label": "x", "tip": [31.5, 31.5], "center": [31.5, 37.125]}]
    case, findings = inspect_case(builder.write())
    assert findings == ()
    assert list(case.views) == ["AP", "LAT", "OBL"]


def test_a_real_biplane_pair_has_no_camera_warnings(builder):
    """The calibration of a real C-arm pair: unequal focal lengths and an off-centre principal point are no fault."""
    source = shared_data("jtml_biplane/cases.json")
    pair = json.loads(source.read_text())["cases"][0]
    builder.write()
    for view, real in (("AP", "A"), ("LAT", "B")):
        shutil.copy(source.parent / pair["views"][real]["image"], builder.folder / f"{real}.png")
        matrix = np.array(pair["views"][real]["projection"])
        world_from_cad = np.array(pair["femur_world_from_cad"])
        tip, center = ((matrix @ world_from_cad @ [*point, 1.0]) for point in ([0.0, 0.0, 0.0], [0.0, 22.5, 0.0]))
        builder.view(view).update({"image": f"{real}.png", "projection": matrix.tolist()})
        builder.screw(view).update({"tip": (tip[:2] / tip[2]).tolist(), "center": (center[:2] / center[2]).tolist()})
    case, findings = inspect_case(builder.write())
    assert [str(finding) for finding in findings if "projection" in str(finding.field)] == []
    assert case is not None


SIGMA = {"rotation_deg": 0.2, "translation_mm": 0.5, "focal_percent": 0.1, "principal_point_px": 1.0}


def test_sigmas_of_cameras_are_read(builder):
    builder.view("AP")["sigma"] = SIGMA
    builder.view("LAT")["sigma"] = "auto"
    case, findings = inspect_case(builder.write())
    assert findings == ()
    assert case is not None
    assert case.views["LAT"].sigma == "auto"
    np.testing.assert_allclose(
        case.views["AP"].sigma.by_parameter, [*[np.radians(0.2)] * 3, *[0.5] * 3, 0.001, 1.0, 1.0]
    )
    assert read_case(CaseBuilder(builder.folder.parent / "plain").write()).views["AP"].sigma is None


@pytest.mark.parametrize(
    ("sigma", "said"),
    [
        ({**SIGMA, "rotation_deg": -1.0}, r"views\.AP\.sigma\.rotation_deg: -1\.0; expected 0 or more"),
        (
            {**SIGMA, "rotation_deg": 1e9},
            r"case\.json: views\.AP\.sigma\.rotation_deg: a standard deviation of 1e\+09 degrees is no calibration; "
            r'expected 0 to 20 degrees\. Is it in another unit\? "sigma": "auto" stands for a C-arm',
        ),
        ({**SIGMA, "translation_mm": 500.0}, r"sigma\.translation_mm: a standard deviation of 500 mm .* 0 to 100 mm"),
        ({**SIGMA, "focal_percent": 31.0}, r"sigma\.focal_percent: a standard deviation of 31 percent .* 0 to 30 perc"),
        ({**SIGMA, "principal_point_px": 501.0}, r"sigma\.principal_point_px: a standard deviation of 501 px"),
        (
            {**SIGMA, "focal": 1.0},
            r"views\.AP\.sigma\.focal: unknown key `focal`; the nearest known one is `focal_percent`",
        ),
        ("free", r'views\.AP\.sigma: "free"; expected \'auto\''),
        ({"rotation_deg": 1.0}, r"views\.AP\.sigma\.translation_mm: the key is missing"),
    ],
)
def test_wrong_sigmas_are_named_once(builder, sigma, said):
    builder.view("AP")["sigma"] = sigma
    case, findings = inspect_case(builder.write())
    assert case is None
    assert any(re.search(said, str(finding)) for finding in findings), [str(f) for f in findings]
    assert not any("literal" in str(finding) or "CameraSigmaFile" in str(finding) for finding in findings)
    assert len(findings) == (3 if sigma == {"rotation_deg": 1.0} else 1)
