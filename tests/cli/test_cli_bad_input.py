"""Each bad input through the program: one clear error that names file, field, expectation and remedy, or a right
result; and nothing left behind."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner
from typer.testing import Result as Run

from screwpose.cli import app
from screwpose.files import read_case
from screwpose.pairing.hypotheses import combinations
from screwpose.pairing.segment import LandmarkNoise
from tests.cli import bad_inputs as bad
from tests.cli.bad_inputs import Mistake
from tests.cli.case_folder import QUICK, SIGMA, CaseFolder

RUN = CliRunner()
_NO_PAIRING = (
    r"annotations: no pairing of the screws explains the landmarks: .*expected rays that meet.*Check that each matrix"
)

# What is wrong, and the error behind the path of the case's folder. Found by reading: `check` and `solve` leave by 3.
REFUSED: dict[Mistake, str] = {
    bad.missing_case: r"/case\.json: there is no such file\. Check the path\.",
    bad.case_is_a_list: (
        r"/case\.json: the file holds \[\]; expected an object, \{ \}, with "
        r'"format": "screwpose-case/1"'
    ),
    bad.case_is_a_folder: r"/case\.json: this is a folder; expected a JSON file",
    bad.case_is_cut: r"/case\.json: not JSON: line \d+, column \d+: .*; expected a JSON file",
    bad.empty_id: r'/case\.json: id: ""; expected text that is not empty',
    bad.missing_image: r"/case\.json: views\.AP\.image: there is no file `app\.png` in .*\. Is `ap\.png` meant\?",
    bad.unreadable_image: (
        r"/ap\.png: views\.AP\.image: it cannot be decoded as PNG \(.*\); "
        r"expected a whole PNG file\. Exp"
    ),
    bad.image_of_text: (
        r"/ap\.png: views\.AP\.image: it is of no known image format; expected "
        r"a PNG, TIFF .* DICOM .*Exp"
    ),
    bad.image_at_half_size_marks_at_full: (
        r"/case\.json: annotations\.AP\[1\]\.center: \[151\.\d+, 133\.\d+\] of "
        r"screw 2 is "
        r"23\.\d+ px outside the image, the worst of 4 .*expected u from -0\.5 to 127\.5 .* in an image of another"
    ),
    bad.black_image: (
        r"/ap\.png: views\.AP\.image: all 256 x 256 pixels have the value 0 "
        r"\(all-black image\); expected an X-r"
    ),
    bad.coloured_image: (
        r"/ap\.png: views\.AP\.image: it is a colour image: 0\.3% .*column 7, "
        r"row 5 is \[255, 0, 0\]; expected a"
        r" grey image of 8 or 16 bit\. Export the X-ray itself as grey"
    ),
    bad.one_pixel_image: r"/ap\.png: views\.AP\.image: all 1 x 1 pixels have the value 7; expected an X-ray",
    bad.tiny_image: (
        r"/case\.json: views\.AP\.image: the image is 2 x 2 px; expected an "
        r"X-ray of at least 32 px each way"
    ),
    bad.long_thin_image: (
        r"/case\.json: views\.AP\.image: the image is 20000 x 1 px; expected an "
        r"X-ray of at least 32 px"
    ),
    bad.image_twice: (
        r"/case\.json: views\.LAT\.image: the image is the same, pixel for "
        r"pixel, as that of AP; .*twice\?"
    ),
    bad.image_link_out: (
        r"/case\.json: views\.AP\.image: `ap\.png` leaves the case's folder "
        r"through a link, to .*outside\.png"
    ),
    bad.path_leaves: (
        r"/case\.json: views\.AP\.image: `\.\./secret\.png` leaves the case's "
        r"folder; expected a path .*Copy the"
    ),
    bad.mask_of_other_size: (
        r"/mask\.png: views\.AP\.mask: the mask is 120 x 100 px and its X-ray "
        r"256 x 256; expected 256 x 256"
    ),
    bad.black_mask: r"/mask\.png: views\.AP\.mask: the mask is black all over: nothing would count; expected non-zero",
    bad.dicom_without_pixels: (
        r"/ap\.dcm: views\.AP\.image\.PixelData: this DICOM has no pixel data; "
        r"expected a .*Fetch the whole"
    ),
    bad.transposed: r"/case\.json: views\.AP\.projection: has 4 rows of 3; expected 3 rows of 4 .* looks transposed",
    bad.transposed_and_cut_anew: (
        r"/case\.json: views\.AP\.projection: the numbers make no camera "
        r".*column by column; .*row by row"
    ),
    bad.behind_the_source: (
        r"/case\.json: views\.AP\.projection: negative depth: .* lie 60\d\.\d "
        r"mm behind the X-ray source; .*"
    ),
    bad.singular_matrix: (
        r"/case\.json: views\.AP\.projection: a singular projection matrix: .*; "
        r"expected P = K \[R \| t\]"
    ),
    bad.zero_matrix: r"/case\.json: views\.AP\.projection: a singular projection matrix",
    bad.huge_matrix: (
        r"/case\.json: views\.AP\.projection\[0\]\[0\]: 1e\+308 is too large a "
        r"number, and so for 11 more of its num"
    ),
    bad.huge_entry: (
        r"/case\.json: views\.AP\.projection\[0\]\[3\]: 1e\+308 is too large a "
        r"number; expected at most 1e\+15"
    ),
    bad.huge_scale: r"/case\.json: views\.AP\.projection\[0\]\[0\]: 8\.4\d*e\+302 is too large a number",
    bad.huge_landmark: r"/case\.json: annotations\.AP\[0\]\.tip\[0\]: 1e\+308 is too large a number, and so for 1 more",
    bad.huge_model_landmark: r"/case\.json: models\.ms55x50\.center\[1\]: 1e\+308 is too large a number",
    bad.same_matrix_twice: (
        r"/case\.json: views\.LAT\.projection: the matrix is the same as that "
        r"of AP; expected a view from an"
    ),
    bad.mesh_in_inches: (
        r"/case\.json: models\.ms55x50\.unit: the mesh is 5\.7\d* mm long, read "
        r"as `mm`, and the center .* lies 19\."
        r"\d+ mm outside of it; expected a screw of 20 to 250 mm.* as `inch` it would be 146 mm"
    ),
    bad.mesh_in_metres: (
        r"/case\.json: models\.ms55x50\.unit: the mesh is 0\.146 mm long, .*Set "
        r"the mesh's unit: as `m` it would be "
        r"146 mm"
    ),
    bad.model_in_metres: r"/case\.json: models\.ms55x50\.unit: the mesh is 0\.146 mm long, read as `mm`; .* as `m` it",
    bad.mesh_declared_in_inches: (
        r"/case\.json: models\.ms55x50\.unit: the mesh is 37\d\d mm long, read "
        r"as `inch`; .* as `mm` it w"
    ),
    bad.unknown_unit: r"""/case\.json: models\.ms55x50\.unit: "-mm"; expected 'mm', 'cm', 'm' or 'inch'""",
    bad.negative_unit: r"/case\.json: models\.ms55x50\.unit: -1; expected 'mm', 'cm', 'm' or 'inch'",
    bad.empty_mesh: (
        r"/models/ms55x50\.stl: models\.ms55x50\.mesh: the mesh file is empty "
        r"\(0 bytes\)\. Export or copy it again"
    ),
    bad.mesh_without_faces: (
        r"/models/ms55x50\.stl: models\.ms55x50\.mesh: the mesh has no faces; "
        r"expected triangles or polyg"
    ),
    bad.truncated_mesh: (
        r"/models/ms55x50\.stl: models\.ms55x50\.mesh: the STL file is cut "
        r"short: .*Export or copy it again"
    ),
    bad.mesh_with_nan: (
        r"/models/ms55x50\.stl: models\.ms55x50\.mesh: 1 of \d+ faces have a "
        r"coordinate that is not finite"
    ),
    bad.model_is_its_case: (
        r"/case\.json: models\.ms55x50\.mesh: '\.json' is no mesh format that "
        r"can be read; expected \.stl"
    ),
    bad.ends_of_model_swapped: (
        r"/case\.json: models\.ms55x50\.tip: tip \[0\.0, 25\.0, 0\.0\] and "
        r"center .* look swapped: .*change"
    ),
    bad.zero_length_screw: (
        r"/case\.json: models\.ms55x50\.center: it is the same point as the "
        r"tip, \[0\.0, 0\.0, 0\.0\]; expected"
    ),
    bad.nan_in_landmarks: (
        r"/case\.json: annotations\.AP\[0\]\.tip\[0\]: NaN is not a finite "
        r"number; expected .*Mark the point again"
    ),
    bad.landmark_outside: (
        r"/case\.json: annotations\.AP\[0\]\.tip: \[700, 100\] of screw 1 is "
        r"444\.5 px outside the image; expected u"
    ),
    bad.label_missing: (
        r"/case\.json: annotations\.AP\[1\]\.label: the key is missing; "
        r'expected the screw\'s name .* Add "label": "1"'
    ),
    bad.no_screws_in_a_view: (
        r"/case\.json: annotations: screws are marked in fewer than two views: "
        r"2 in AP and 0 in LAT; expec"
    ),
    bad.duplicate_labels: (
        r'/case\.json: annotations\.AP\[1\]\.label: "1" is also the label of '
        r"annotations\.AP\[0\]; expected each la"
    ),
    bad.unknown_key: (
        r"/case\.json: views\.AP\.polarty: unknown key `polarty`; the nearest "
        r"known one is `polarity`; expected"
    ),
    bad.unknown_model: (
        r"/case\.json: annotations\.AP\[0\]\.model: the case has no model "
        r'"ms55x5"; .*Is `ms55x50` meant\?'
    ),
    bad.annotations_of_unknown_view: (
        r"/case\.json: annotations\.lat: there is no view of this name; .*Is "
        r"`LAT` meant\?"
    ),
}

# Found by holding landmarks, matrices and models against each other: `check` leaves by 3, `solve` refuses by 5.
CONTRADICTED: dict[Mistake, str] = {
    bad.image_at_half_size: (
        r"views\.AP\.projection: .* the matrix of AP is for an image of 256 x "
        r"256 px: this one has 128 x 128"
    ),
    bad.rotation_transposed: r"views\.AP\.projection: .* the rotation in the matrix of AP is transposed\. Make P = K",
    bad.both_rotations_transposed: (
        r"views\.AP\.projection: .* the rotation in the matrices of AP and LAT "
        r"is transposed"
    ),
    bad.poses_inverted: r"views\.AP\.projection: .* the pose in the matrices of AP and LAT is inverted",
    bad.matrices_in_metres: (
        r"views\.AP\.projection: .* the projection matrices are in metres, not "
        r"mm: the sources are 0\.6"
    ),
    bad.one_matrix_in_metres: (
        r"views\.AP\.projection: .* the matrix of AP, unlike the others, is in "
        r"metres\. Scale the last"
    ),
    bad.views_swapped: (
        r"views\.AP\.projection: .* only if the matrices of AP and LAT change "
        r"places\. Swap the projections"
    ),
    bad.rows_and_columns_swapped: (
        r"annotations: the landmarks fit only if read as \[row, column\]\. Give "
        r"every position as"
    ),
    bad.model_in_inches: (
        r"models\.ms55x50: .* tip and center of the model ms55x50 are in "
        r"inches: .* apart\..* by 25\.4"
    ),
    bad.center_of_the_whole: _NO_PAIRING,
    bad.ends_swapped_in_one_view: (
        r"annotations\.AP: .* if tip and center of every screw in AP, or in the "
        r"other view, change"
    ),
}

# A right result, with a warning where something is worth a word.
ANSWERED: dict[Mistake, str | None] = {
    bad.equal_channels: r"views\.AP\.image: Three equal colour channels were read as grey",
    bad.dicom_inverted: None,
    bad.sign_changed: None,
    bad.mesh_in_inches_rightly: None,
    bad.open_mesh: r"models\.ms55x50\.mesh: It is not closed: \d+ open edges",
    bad.inside_out_mesh: r"models\.ms55x50\.mesh: 1 of 1 bodies inside out",
    bad.part_is_the_model: r"models\.ms55x50\.pivot: the key is missing, and there are parts",
    bad.screw_missing_in_a_view: r"annotations: the views show different numbers of screws: 2 in AP and 1 in LAT",
}

# What cannot be known from the landmarks alone: an answer, but no confident one.
DOUBTED: dict[Mistake, str | None] = {
    bad.ends_of_one_mark_swapped: (
        r"annotations\.LAT\[0\]: the screws AP 1 = LAT b and AP 2 = LAT a point "
        r"against each other"
    ),
    bad.labels_of_one_screw_twice: r'annotations\.AP\[1\]: screw "2" is marked at the same place as "1"',
    bad.images_swapped: None,
    bad.ends_swapped_everywhere: None,
}


@pytest.fixture
def spoilt(case: CaseFolder, request: pytest.FixtureRequest) -> CaseFolder:
    before = json.dumps(case.data)
    request.param(case)
    if json.dumps(case.data) != before:
        case.save()
    return case


def over(mistakes: dict[Mistake, str] | dict[Mistake, str | None]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        ("spoilt", "said"),
        [pytest.param(mistake, said, id=mistake.__name__) for mistake, said in mistakes.items()],
        indirect=["spoilt"],
    )


def program(*arguments: str | Path) -> Run:
    """Run the program; anything but an orderly exit is a failure here."""
    result = RUN.invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def one_line(text: str) -> str:
    return " ".join(text.split())


def check_says(case: CaseFolder, said: str) -> None:
    """`check` gives one error, first, in lines of at most 80 columns, and leaves by 3."""
    result = program("check", case.folder, *SIGMA)
    assert result.exit_code == 3, result.output
    assert re.search(said, one_line(result.stdout)), result.stdout
    assert result.stdout.startswith("error: ")
    assert f"{case.folder}: 1 error, " in result.stdout
    for line in result.stdout.splitlines():
        assert len(line) <= 80 or max(map(len, line.split())) > 40, line


@over(REFUSED)
def test_what_cannot_be_used_is_one_clear_error(spoilt: CaseFolder, said: str, tmp_path: Path) -> None:
    said = re.escape(str(spoilt.folder)) + said
    before = sorted(tmp_path.iterdir())
    check_says(spoilt, said)
    result = program("solve", spoilt.folder, "-o", tmp_path / "out", *QUICK)
    assert result.exit_code == 3
    assert result.stdout == ""
    *progress, message = result.stderr.splitlines()
    assert re.search(said, message), message
    assert message.startswith("screwpose: ")
    assert "more error" not in message
    assert all(re.match(r" *\d+%  ", line) for line in progress)
    assert sorted(tmp_path.iterdir()) == before  # no output, and no part of one


@over(CONTRADICTED)
@pytest.mark.usefixtures("brief_report")
def test_what_contradicts_itself_is_refused(spoilt: CaseFolder, said: str, tmp_path: Path) -> None:
    check_says(spoilt, re.escape(f"{spoilt.folder}/case.json: ") + said)
    result = program("solve", spoilt.folder, "-o", tmp_path / "out", *QUICK)
    assert result.exit_code == 5
    assert re.search(said, one_line(result.stdout)), result.stdout
    answer = json.loads((tmp_path / "out" / "result.json").read_text())
    assert answer["status"] == answer["pairing"]["status"] == "refused"
    assert answer["screws"] == []
    assert re.search(said, "\n".join(answer["warnings"]))


def answer_of(case: CaseFolder, said: str | None, out: Path) -> dict:
    check = program("check", case.folder, *SIGMA)
    assert check.exit_code == 0, check.output
    assert re.search(said or "nothing wrong was found", one_line(check.stdout)), check.stdout
    result = program("solve", case.folder, "-o", out, *QUICK)
    assert result.exit_code == 0, result.output
    answer = json.loads((out / "result.json").read_text())
    if said:
        assert re.search(said, "\n".join(answer["warnings"]))
    return answer


@over(ANSWERED)
@pytest.mark.usefixtures("brief_report")
def test_what_can_be_used_gives_the_right_answer(spoilt: CaseFolder, said: str | None, tmp_path: Path) -> None:
    answer = answer_of(spoilt, said, tmp_path / "out")
    assert answer["pairing"]["status"] == "confident"
    truth = json.loads((spoilt.folder / "truth.json").read_text())["screws"]
    marked = {(view, mark["label"]) for view in ("AP", "LAT") for mark in spoilt.marks(view)}
    expected = [screw["labels"] for screw in truth if set(screw["labels"].items()) <= marked]
    # A screw without a partner is in the X-rays and in no model: beside it another may be one to check.
    assert answer["status"] == "confident" or len(expected) < len(truth)
    assert sorted(answer["pairing"]["pairs"], key=str) == sorted(expected, key=str)


@over(DOUBTED)
@pytest.mark.usefixtures("brief_report")
def test_what_cannot_be_known_is_not_confident(spoilt: CaseFolder, said: str | None, tmp_path: Path) -> None:
    answer = answer_of(spoilt, said, tmp_path / "out")
    assert answer["status"] == "ambiguous"
    assert any(screw["status"] != "ok" for screw in answer["screws"])


@pytest.mark.usefixtures("brief_report")
def test_marks_that_are_no_screw_stay_alone(case: CaseFolder, tmp_path: Path) -> None:
    bad.strange_screws(case)
    case.save()
    answer = answer_of(
        case, "annotations: AP n, LAT n: no two of these marks fit each other as one screw", tmp_path / "out"
    )
    assert answer["status"] == "ambiguous"
    assert answer["pairing"]["pairs"] == [{"AP": "1", "LAT": "b"}, {"AP": "2", "LAT": "a"}]
    assert answer["pairing"]["unpaired"] == {"AP": ["n"], "LAT": ["n"]}


def test_five_screws_in_one_view_and_three_in_the_other(case: CaseFolder) -> None:
    bad.three_more_screws(case)
    case.save()
    result = program("check", case.folder, *SIGMA)
    assert result.exit_code == 0, result.stdout
    assert "the views show different numbers of screws: 5 in AP and 3 in LAT" in one_line(result.stdout)
    best = combinations(read_case(case.folder), LandmarkNoise(0.5), 1)[0]
    assert {one.labels for one in best.hypotheses} == {
        (("AP", "1"), ("LAT", "b")),
        (("AP", "2"), ("LAT", "a")),
        (("AP", "n0"), ("LAT", "n")),
    }
    assert sorted(best.unpaired["AP"]) == ["n1", "n2"]


def test_a_good_case_has_nothing_wrong(case: CaseFolder) -> None:
    result = program("check", case.folder, *SIGMA)
    assert (result.exit_code, result.stdout) == (0, f"{case.folder}: nothing wrong was found\n")


def test_everything_is_listed_at_once_errors_first(case: CaseFolder) -> None:
    for mistake in (bad.open_mesh, bad.duplicate_labels, bad.black_image, bad.unknown_key):
        mistake(case)
    case.save()
    result = program("check", case.folder, *SIGMA)
    assert result.exit_code == 3
    levels = re.findall(r"^(error|warning): ", result.stdout, re.MULTILINE)
    assert levels == ["error", "error", "error", "warning"]
    assert result.stdout.endswith(f"{case.folder}: 3 errors, 1 warning\n")
    solved = program("solve", case.folder, "-o", case.folder.parent / "out")
    assert f"There are 2 more errors: `screwpose check {case.folder}` lists them." in solved.stderr


def test_labels_are_shown_and_not_obeyed(case: CaseFolder) -> None:
    case.marks("AP")[0]["label"] = case.marks("AP")[1]["label"] = "\x1b[31m\n\u202e[red]"
    case.save()
    result = program("check", case.folder)
    assert r"\x1b[31m\n\u202e[red]" in one_line(result.stdout)
    assert "\x1b" not in result.stdout
    assert "\u202e" not in result.stdout
