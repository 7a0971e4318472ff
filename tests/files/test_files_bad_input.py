"""Each bad input is answered by one clear error: file, field, value, expectation, remedy."""

import json
import re

import numpy as np
import pytest

from screwpose.errors import AnnotationError, CalibrationError, CaseError, ImageError, MeshError
from screwpose.files import errors_in, inspect_case, read_case
from tests.files.builder import AP, CaseBuilder, box_stl


@pytest.fixture
def builder(tmp_path):
    return CaseBuilder(tmp_path / "case")


def _set(view, key, value):
    return lambda b: b.view(view).update({key: value})


def _mark(view, key, value):
    return lambda b: b.screw(view).update({key: value})


def _model(key, value):
    return lambda b: b.data["models"]["box"].update({key: value})


def _without(keys):
    def spoil(b):
        holder = b.data
        for key in keys[:-1]:
            holder = holder[key]
        del holder[keys[-1]]

    return spoil


def _rename(keys, new):
    def spoil(b):
        holder = b.data
        for key in keys[:-1]:
            holder = holder[key]
        holder[new] = holder.pop(keys[-1])

    return spoil


BOX = box_stl([-3, 0, -3], [3, 45, 3])

# What is spoilt, the class of the error, and its text behind the file's name. Every row must leave exactly one error.
BAD = {
    # paths
    "missing image": (
        _set("AP", "image", "app.png"),
        ImageError,
        r"case\.json: views\.AP\.image: there is no file `app\.png` in .*case\. Is `ap\.png` meant\?",
    ),
    "missing image, nothing like it": (
        _set("AP", "image", "other/frontal.tif"),
        ImageError,
        r"views\.AP\.image: there is no file `other/frontal\.tif` .* Paths are relative to the case file's folder\.",
    ),
    "image is a folder": (
        _set("AP", "image", "models"),
        ImageError,
        r"views\.AP\.image: `models` is a folder; expected a file\.",
    ),
    "missing mesh": (
        _model("mesh", "models/bx.stl"),
        MeshError,
        r"models\.box\.mesh: there is no file `models/bx\.stl` .* Is `models/box\.stl` meant\?",
    ),
    "path goes up": (
        _set("AP", "image", "../case/ap.png"),
        CaseError,
        r"views\.AP\.image: `\.\./case/ap\.png` leaves the case's folder; expected a path that stays in it\. Copy",
    ),
    "path goes up in the middle": (
        _set("AP", "image", "models/../../ap.png"),
        CaseError,
        r"views\.AP\.image: `models/\.\./\.\./ap\.png` leaves the case's folder",
    ),
    "absolute path": (
        _set("AP", "mask", "/etc/passwd"),
        CaseError,
        r"views\.AP\.mask: `/etc/passwd` is an absolute path; expected a path relative .*\. Copy the file into",
    ),
    "drive letter": (
        _model("mesh", "C:\\cad\\box.stl"),
        CaseError,
        r"models\.box\.mesh: `C:\\cad\\box\.stl` begins with a drive letter; expected .* forward slashes\. Copy",
    ),
    "backslash": (
        _model("mesh", "models\\box.stl"),
        CaseError,
        r"models\.box\.mesh: `models\\box\.stl` holds a backslash; .* Write / instead\.",
    ),
    "zero character": (
        _set("AP", "image", "ap\0.png"),
        CaseError,
        r"views\.AP\.image: the path holds a zero character",
    ),
    "link out of the folder": (
        lambda b: (b.folder.mkdir(), (b.folder / "etc").symlink_to("/etc"), b.view("AP").update(image="etc/hostname")),
        CaseError,
        r"views\.AP\.image: `etc/hostname` leaves the case's folder through a link, to /etc/hostname",
    ),
    # images
    "all-black image": (
        lambda b: b.images.update({"ap.png": np.zeros((64, 64), dtype=np.uint8)}),
        ImageError,
        r"ap\.png: views\.AP\.image: all 64 x 64 pixels have the value 0 \(all-black image\); expected an X-ray",
    ),
    "unreadable image": (
        lambda b: b.view("AP").update(image="models/box.stl"),
        ImageError,
        r"box\.stl: views\.AP\.image: it is .*; expected a PNG, TIFF .* Export the X-ray in one of these formats",
    ),
    "mask of another size": (
        lambda b: (b.images.update({"m.png": np.ones((32, 64), dtype=np.uint8)}), b.view("AP").update(mask="m.png")),
        ImageError,
        r"m\.png: views\.AP\.mask: the mask is 64 x 32 px and its X-ray 64 x 64; expected 64 x 64 px",
    ),
    "target of another size": (
        lambda b: (b.images.update({"t.png": np.ones((64, 32), dtype=np.uint8)}), b.view("LAT").update(target="t.png")),
        ImageError,
        r"t\.png: views\.LAT\.target: the mask is 32 x 64 px and its X-ray 64 x 64",
    ),
    "mask with nothing in it": (
        lambda b: (b.images.update({"m.png": np.zeros((64, 64), dtype=np.uint8)}), b.view("AP").update(mask="m.png")),
        ImageError,
        r"m\.png: views\.AP\.mask: the mask is black all over: nothing would count; expected non-zero pixels",
    ),
    # projections
    "transposed projection": (
        _set("AP", "projection", AP.T.tolist()),
        CaseError,
        r"views\.AP\.projection: has 4 rows of 3; expected 3 rows of 4 numbers\. The matrix looks transposed: give",
    ),
    "projection cut anew": (
        _set("AP", "projection", AP.T.reshape(3, 4).tolist()),
        CalibrationError,
        r"views\.AP\.projection: the numbers make no camera of this image as they stand, but one if they are read",
    ),
    "4 x 4 projection": (
        _set("AP", "projection", np.vstack([AP, [0, 0, 0, 1]]).tolist()),
        CaseError,
        r"views\.AP\.projection: has 4 rows of 4; expected 3 rows of 4 numbers\. .* without the last row; a pose alone",
    ),
    "intrinsics alone": (
        _set("AP", "projection", np.eye(3).tolist()),
        CaseError,
        r"views\.AP\.projection: has 3 rows of 3; .* Give P = K \[R \| t\], not the intrinsics K alone\.",
    ),
    "ragged projection": (
        _set("AP", "projection", [[1, 0, 0, 0], [0, 1, 0], [0, 0, 1, 0]]),
        CaseError,
        r"views\.AP\.projection: has rows of different lengths; expected 3 rows of 4 numbers",
    ),
    "projection is no list": (
        _set("AP", "projection", "P.txt"),
        CaseError,
        r"views\.AP\.projection: 'P\.txt'; expected 3 rows of 4 numbers",
    ),
    "projection of zeros": (
        _set("AP", "projection", np.zeros((3, 4)).tolist()),
        CalibrationError,
        r"case\.json: views\.AP\.projection: a singular projection matrix: .*; expected P = K \[R \| t\]",
    ),
    "last row zero": (
        _set("AP", "projection", [*AP[:2].tolist(), [0, 0, 0, 1]]),
        CalibrationError,
        r"views\.AP\.projection: a singular projection matrix",
    ),
    "text among the numbers": (
        _set("AP", "projection", [["200", 0, 31.5, 25200], *AP[1:].tolist()]),
        CaseError,
        r'views\.AP\.projection\[0\]\[0\]: "200" is text; expected a number\. Take the quotes away\.',
    ),
    "null among the numbers": (
        _set("AP", "projection", [[None, 0, 31.5, 25200], *AP[1:].tolist()]),
        CaseError,
        r"views\.AP\.projection\[0\]\[0\]: null; expected a number\.",
    ),
    "one calibration twice": (
        _set("LAT", "projection", (2 * AP).tolist()),
        CalibrationError,
        r"views\.LAT\.projection: the matrix is the same as that of AP; expected a view from another direction\. Was",
    ),
    "views almost parallel": (
        _set("LAT", "projection", (AP @ np.array([[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])).tolist()),
        CalibrationError,
        r"case\.json: views: the rays of the views differ by 0 degrees at most, 3 are needed: .* 120 degrees",
    ),
    # models
    "empty mesh": (
        lambda b: b.meshes.update({"models/box.stl": ""}),
        MeshError,
        r"box\.stl: models\.box\.mesh: the mesh file is empty \(0 bytes\)",
    ),
    "mesh without faces": (
        lambda b: b.meshes.update({"models/box.stl": "solid box\nendsolid box\n"}),
        MeshError,
        r"box\.stl: models\.box\.mesh: .*no faces",
    ),
    "broken mesh": (
        lambda b: b.meshes.update({"models/box.stl": BOX[: len(BOX) // 2]}),
        MeshError,
        r"box\.stl: models\.box\.mesh: ",
    ),
    "NaN in the mesh": (
        lambda b: b.meshes.update({"models/box.stl": BOX.replace("vertex 3", "vertex nan", 1)}),
        MeshError,
        r"box\.stl: models\.box\.mesh: .*not finite",
    ),
    "unknown unit": (
        _model("unit", "inches"),
        CaseError,
        r"models\.box\.unit: \"inches\"; expected 'mm', 'cm', 'm' or 'inch'",
    ),
    "unit of a STEP file": (
        lambda b: (
            b.meshes.update({"models/box.step": "ISO-10303-21;"}),
            b.data["models"]["box"].update(mesh="models/box.step", unit="m"),
        ),
        MeshError,
        r"box\.step: models\.box\.unit: the unit 'm' was given for a STEP file, which states its own\. Leave",
    ),
    "model without a tip": (
        _without(["models", "box", "tip"]),
        CaseError,
        r"models\.box\.tip: the key is missing; expected the screw's tip in the CAD frame, \[x, y, z\] in mm\. "
        r"`screwpose model inspect FILE` proposes landmarks",
    ),
    "landmarks of a model are equal": (
        _model("center", [0, 0, 0]),
        MeshError,
        r"models\.box\.center: it is the same point as the tip, \[0\.0, 0\.0, 0\.0\]; expected two points",
    ),
    "landmark in the plane": (
        _model("tip", [0, 0]),
        CaseError,
        r"models\.box\.tip: has a list of 2; expected 3 numbers, \[x, y, z\]",
    ),
    "parts of one name": (
        _model("parts", [{"name": "a", "mesh": "models/box.stl"}] * 2),
        CaseError,
        r'models\.box\.parts\[1\]\.name: "a" is the name of another part of this model; expected each name once',
    ),
    "missing part": (
        _model("parts", [{"name": "a", "mesh": "models/a.stl"}]),
        MeshError,
        r"models\.box\.parts\[0\]\.mesh: there is no file `models/a\.stl`",
    ),
    "no models": (
        lambda b: (b.data.update(models={}), b.screw("AP").pop("model")),
        CaseError,
        r"case\.json: models: has 0; expected 1 or more",
    ),
    # annotations
    "label is a number": (
        _mark("AP", "label", 1),
        CaseError,
        r"annotations\.AP\[0\]\.label: 1; expected text in quotes\. Put it in quotes\.",
    ),
    "empty label": (
        _mark("AP", "label", ""),
        CaseError,
        r'annotations\.AP\[0\]\.label: ""; expected text that is not empty',
    ),
    "duplicate labels": (
        lambda b: (b.add_screw("AP", label="1"), b.add_screw("LAT")),
        AnnotationError,
        r'annotations\.AP\[1\]\.label: "1" is also the label of annotations\.AP\[0\]; expected each label once in',
    ),
    "landmark far outside": (
        _mark("AP", "tip", [412.5, 33.0]),
        AnnotationError,
        r"annotations\.AP\[0\]\.tip: \[412\.5, 33\] of screw 1 is 349 px outside the image; "
        r"expected u from -0\.5 to 63\.5 and v from -0\.5 to 63\.5\. Was it marked in an image of another size\?",
    ),
    "tip and centre equal": (
        _mark("AP", "center", [31.5, 31.5]),
        AnnotationError,
        r"annotations\.AP\[0\]\.center: tip and center of screw 1 are the same point, \[31\.5, 31\.5\]; expected two",
    ),
    "landmark with three numbers": (
        _mark("AP", "tip", [31.5, 31.5, 1.0]),
        CaseError,
        r"annotations\.AP\[0\]\.tip: has a list of 3; expected 2 numbers, \[u, v\]",
    ),
    "unknown model": (
        _mark("AP", "model", "boxx"),
        AnnotationError,
        r'annotations\.AP\[0\]\.model: the case has no model "boxx"; expected one of `box`\. Is `box` meant\?',
    ),
    "view without annotations": (
        _without(["annotations", "LAT"]),
        AnnotationError,
        r"annotations\.LAT: the view has no list of annotations; expected a list for each view of the case\. Mark its",
    ),
    "annotations of no view": (
        lambda b: b.data["annotations"].update(LATERAL=[]),
        AnnotationError,
        r"annotations\.LATERAL: there is no view of this name; expected one of `AP`, `LAT`\. Is `LAT` meant\?",
    ),
    "no screw at all": (
        lambda b: b.data.update(annotations={"AP": [], "LAT": []}),
        AnnotationError,
        r"annotations: screws are marked in fewer than two views: 0 in AP and 0 in LAT; expected at least one",
    ),
    "screws in one view only": (
        lambda b: b.data["annotations"].update(LAT=[]),
        AnnotationError,
        r"annotations: screws are marked in fewer than two views: 1 in AP and 0 in LAT; .* in a second view\.",
    ),
    "annotations are a list": (
        lambda b: b.data.update(annotations=[]),
        CaseError,
        r"annotations: \[\]; expected an object, \{ \}",
    ),
    # keys
    "unknown key": (
        _rename(["annotations", "AP", 0, "center"], "centre"),
        CaseError,
        r"annotations\.AP\[0\]\.centre: unknown key `centre`; the nearest known one is `center`; "
        r"expected one of `label`, `tip`, `center`, `model`\. Rename it to `center`\.",
    ),
    "unknown key at the top": (
        lambda b: b.data.update(xyzzy=1),
        CaseError,
        r"case\.json: xyzzy: unknown key `xyzzy`; expected one of `format`, `id`, .*\. Take it out\.",
    ),
    "missing projection": (
        _without(["views", "AP", "projection"]),
        CaseError,
        r"views\.AP\.projection: the key is missing; expected the projection matrix P, 3 rows of 4, pixels from",
    ),
    "polarity misspelt": (
        _set("AP", "polarity", "dark"),
        CaseError,
        r"views\.AP\.polarity: \"dark\"; expected 'metal-dark', 'metal-bright' or 'auto'",
    ),
    "one view": (
        lambda b: (b.data["views"].pop("LAT"), b.data["annotations"].pop("LAT")),
        CaseError,
        r"case\.json: views: has 1; expected 2 or more\. Depth needs a second view from another direction\.",
    ),
    "no format": (
        _without(["format"]),
        CaseError,
        r'case\.json: format: the key is missing; expected "screwpose-case/1"\. Add "format": "screwpose-case/1"',
    ),
    "newer format": (
        lambda b: b.data.update(format="screwpose-case/2"),
        CaseError,
        r'format: "screwpose-case/2"; expected "screwpose-case/1"\. This version of the format is not known here',
    ),
    "same image twice": (
        lambda b: b.images.update({"lat.png": b.images["ap.png"]}),
        ImageError,
        r"views\.LAT\.image: the image is the same, pixel for pixel, as that of AP; .* given twice\?",
    ),
    "image of a few pixels": (
        lambda b: b.images.update({"ap.png": b.images["ap.png"][:20]}),
        ImageError,
        r"views\.AP\.image: the image is 64 x 20 px; expected an X-ray of at least 32 px each way\. Is it the right",
    ),
    "tip and center of the model swapped": (
        lambda b: b.data["models"]["box"].update(tip=[0, 22.5, 0], center=[0, 0, 0]),
        MeshError,
        r"models\.box\.tip: tip \[0\.0, 22\.5, 0\.0\] and center \[0\.0, 0\.0, 0\.0\] look swapped: the mesh ends "
        r"at the center, .* Let them change places\.",
    ),
    "mesh in metres": (
        lambda b: b.meshes.update({"models/box.stl": box_stl([-0.003, 0, -0.003], [0.003, 0.045, 0.003])}),
        MeshError,
        r"models\.box\.unit: the mesh is 0\.045 mm long, read as `mm`, and the center \[0\.0, 22\.5, 0\.0\] lies "
        r"22\.4\d mm outside of it; expected a screw of 20 to 250 mm, and landmarks on it\. Set the mesh's unit: "
        r"as `m` it would be 45 mm long\. Tip and center stand in mm, whatever it is\.",
    ),
    "mesh in inches": (
        lambda b: b.meshes.update({"models/box.stl": box_stl([-0.12, 0, -0.12], [0.12, 1.77, 0.12])}),
        MeshError,
        r"models\.box\.unit: the mesh is 1\.77 mm long, read as `mm`, and the center .* as `inch` it would be 44\.96",
    ),
    "mesh declared in metres": (
        _model("unit", "m"),
        MeshError,
        r"models\.box\.unit: the mesh is 4\.5e\+04 mm long, read as `m`; .* Set the mesh's unit: as `mm` it would be",
    ),
    "center of another frame": (
        _model("center", [0, 1e6, 0]),
        MeshError,
        r"models\.box\.center: the mesh is 45 mm long, read as `mm`, and the center .* Give tip and center in mm, in "
        r"the frame of the mesh: it spans \[-3, 0, -3\] to \[3, 45, 3\]\.",
    ),
    "number too large": (
        _mark("AP", "tip", [1e308, 30.0]),
        CaseError,
        r"annotations\.AP\[0\]\.tip\[0\]: 1e\+308 is too large a number; expected at most 1e\+15 in size\.",
    ),
    "view's name in small letters": (
        lambda b: b.data["annotations"].update(lat=b.data["annotations"].pop("LAT")),
        AnnotationError,
        r"annotations\.lat: there is no view of this name; expected one of `AP`, `LAT`\. Is `LAT` meant\?",
    ),
    "several landmarks outside": (
        lambda b: b.screw("AP").update(tip=[80.0, 31.5], center=[90.0, 31.5]),
        AnnotationError,
        r"AP\[0\]\.center: \[90, 31\.5\] of screw 1 is 26\.5 px outside the image, the worst of 2 landmarks outside",
    ),
    "another file": (
        lambda b: b.data.update(format="screwpose-truth/1"),
        CaseError,
        r'format: "screwpose-truth/1"; expected "screwpose-case/1"\. This is a truth file: give the other one\.',
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_clear_error(builder, name):
    spoil, kind, pattern = BAD[name]
    spoil(builder)
    builder.write()
    case, findings = inspect_case(builder.file)
    assert case is None
    errors = errors_in(findings)
    assert len(errors) == 1, [str(error) for error in errors]
    assert re.search(pattern, str(errors[0])), str(errors[0])
    with pytest.raises(kind, match=pattern) as raised:
        read_case(builder.folder)
    assert type(raised.value) is kind
    assert raised.value.file is not None
    assert str(builder.folder) in str(raised.value)


@pytest.mark.parametrize(("literal", "said"), [("NaN", "NaN"), ("Infinity", "Infinity"), ("-1e999", "-Infinity")])
def test_a_landmark_that_is_not_finite_is_refused(builder, literal, said):
    builder.screw("AP")["tip"][0] = "HERE"
    builder.write_raw(builder.text().replace('"HERE"', literal))
    case, findings = inspect_case(builder.file)
    assert case is None
    assert [str(finding) for finding in findings] == [
        f"{builder.file}: annotations.AP[0].tip[0]: {said} is not a finite number; expected a finite number. "
        "Mark the point again, or take the screw out of this view."
    ]


def test_everything_is_found_at_once(builder):
    """A fault in one place hides none elsewhere, not even in the same view, model or list."""
    builder.add_screw("LAT")
    builder.view("AP").update(projection=AP.T.tolist(), image="no.png")
    builder.view("LAT").update(mask="../m.png", colour=1)
    builder.data["models"]["box"].update(mesh="models/no.stl", tip=[0, 0])
    builder.screw("AP").update(model="none")
    builder.screw("LAT", 0).update(tip="here")
    builder.screw("LAT", 1).update(tip=[999.0, 0.0])
    builder.write()
    case, findings = inspect_case(builder.file)
    assert case is None
    assert {finding.field for finding in errors_in(findings)} == {
        "views.AP.projection",
        "views.AP.image",
        "views.LAT.mask",
        "views.LAT.colour",
        "models.box.mesh",
        "models.box.tip",
        "annotations.AP[0].model",
        "annotations.LAT[0].tip",
        "annotations.LAT[1].tip",
    }
    levels = [finding.level for finding in findings]
    assert levels == sorted(levels)  # errors before warnings
    with pytest.raises(CaseError, match=r"There are 8 more errors: `screwpose check .*case` lists them\.$"):
        read_case(builder.folder)


def test_two_errors_are_one_more(builder):
    builder.screw("AP").update(model="none")
    builder.screw("LAT").update(model="none")
    with pytest.raises(AnnotationError, match=r"There is 1 more error: `screwpose check .*` lists them\.$"):
        read_case(builder.write())


def test_findings_are_for_machines_too(builder):
    builder.screw("AP").update(model="boxx")
    _, (finding,) = inspect_case(builder.write())
    assert finding.as_dict() == {
        "level": "error",
        "error": "AnnotationError",
        "file": str(builder.file),
        "field": "annotations.AP[0].model",
        "problem": 'the case has no model "boxx"',
        "expected": "one of `box`",
        "remedy": "Is `box` meant?",
    }
    assert json.dumps(finding.as_dict())


def test_a_folder_without_a_case_is_named(tmp_path):
    with pytest.raises(CaseError, match=r"case\.json: there is no such file"):
        read_case(tmp_path)
    with pytest.raises(CaseError, match=r"nothing: there is no such file\. Check the path\."):
        read_case(tmp_path / "nothing")


def test_a_matrix_of_nan_is_one_error(builder):
    builder.view("AP")["projection"] = "HERE"
    builder.write_raw(builder.text().replace('"HERE"', str([[float("nan")] * 4] * 3).replace("nan", "NaN")))
    _, findings = inspect_case(builder.file)
    (error,) = errors_in(findings)
    assert error.field == "views.AP.projection[0][0]"
    assert error.problem == "NaN is not a finite number, and so for 11 more of its numbers"


def test_equal_mistakes_in_two_matrices_are_two_errors(builder):
    for view in ("AP", "LAT"):
        builder.view(view)["projection"][1][1] = 1e300
    _, findings = inspect_case(builder.write())
    assert [error.field for error in errors_in(findings)] == ["views.AP.projection[1][1]", "views.LAT.projection[1][1]"]
