"""The models and the published schemas are CASE_FORMAT's, key by key.

`contract/` holds the contract's own examples, as they stand there; in the summary the blocks that it abbreviates are
written out with all five quantiles.
"""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from screwpose.errors import CaseError
from screwpose.files import (
    errors_in,
    inspect_case,
    read_result,
    read_summary,
    read_truth,
    schema_documents,
    write_result,
    write_summary,
    write_truth,
)
from screwpose.files import schema as models
from screwpose.files.publish_schemas import SHIPPED, publish
from tests.files.plain_validator import faults

CONTRACT = Path(__file__).parent / "contract"
MODEL_OF = {
    "case": models.CaseFile,
    "truth": models.TruthFile,
    "result": models.ResultFile,
    "summary": models.SummaryFile,
}
ROLL_90 = [[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, -20.0], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]]


def example(name):
    return json.loads((CONTRACT / f"{name}.json").read_text())


def changed(name, keys, value):
    """The contract's example with one value changed; None takes the key out."""
    data = example(name)
    holder = data
    for key in keys[:-1]:
        holder = holder[key]
    if value is None:
        del holder[keys[-1]]
    else:
        holder[keys[-1]] = value
    return data


@pytest.mark.parametrize("name", MODEL_OF)
def test_the_contracts_example_is_taken_and_comes_out_the_same(name):
    data = example(name)
    written = MODEL_OF[name].model_validate(data).model_dump(mode="json", exclude_none=True)
    if name == "case":  # the one key that the example gives as null, and the one default that it leaves out
        del data["views"]["AP"]["target"]
        data["views"]["LAT"]["polarity"] = "auto"
    assert written == data


@pytest.mark.parametrize("name", MODEL_OF)
def test_the_published_schema_takes_the_contracts_example(name):
    assert faults(example(name), schema_documents()[name]) == []


@pytest.mark.parametrize("name", MODEL_OF)
def test_the_shipped_schemas_are_what_the_models_say(name, tmp_path):
    publish(tmp_path)
    file = f"{name}.schema.json"
    assert (SHIPPED / file).read_text() == (tmp_path / file).read_text(), "python -m screwpose.files.publish_schemas"
    assert json.loads((SHIPPED / file).read_text())["$id"] == f"urn:screwpose:schema:{name}:1"
    assert len(list(SHIPPED.iterdir())) == len(MODEL_OF)


def _described(node, place):
    if isinstance(node, dict):
        for name, entry in node.get("properties", {}).items():
            assert entry.get("description"), f"{place}.{name} has no description"
        for key, value in node.items():
            _described(value, f"{place}.{key}")


@pytest.mark.parametrize("name", MODEL_OF)
def test_every_key_is_described(name):
    _described(schema_documents()[name], name)


# What both the models and the published schemas must refuse.
REFUSED = {
    "unknown key": ("result", ["statuss"], 1),
    "unknown key deep inside": ("result", ["screws", 0, "sigma", "tip"], 1),
    "another format": ("truth", ["format"], "screwpose-truth/2"),
    "unknown status": ("result", ["status"], "sure"),
    "unknown screw status": ("result", ["screws", 0, "status"], "good"),
    "no warnings key": ("result", ["warnings"], None),
    "no pairs": ("result", ["pairing", "pairs"], None),
    "no pre": ("result", ["combinations", 0, "pre"], None),
    "no views in the scores": ("result", ["combinations", 0, "post", "views"], None),
    "probability above 1": ("result", ["pairing", "probability"], 1.5),
    "dice below 0": ("result", ["combinations", 0, "pre", "dice"], -0.1),
    "loss below -1": ("result", ["combinations", 0, "pre", "views", "AP", "loss"], -1.1),
    "id 0": ("result", ["combinations", 0, "id"], 0),
    "id that is no integer": ("result", ["combinations", 0, "id"], "1"),
    "label that is a number": ("result", ["screws", 0, "labels", "AP"], 1),
    "time below 0": ("result", ["timing_s", "total"], -1),
    "sigma below 0": ("result", ["screws", 0, "sigma", "roll_deg"], -1),
    "tip in the plane": ("result", ["screws", 0, "tip"], [0, 0]),
    "pose of three rows": ("truth", ["screws", 0, "world_from_cad"], ROLL_90[:3]),
    "part without its key": ("result", ["screws", 0, "parts", "shank"], ROLL_90),
    "number as text": ("truth", ["screws", 0, "world_from_cad", 0, 0], "1"),
    "truth as number": ("case", ["annotations", "AP", 0, "tip", 0], True),
    "one view": ("case", ["views", "LAT"], None),
    "no model": ("case", ["models"], {}),
    "half a sigma": ("case", ["views", "AP", "sigma"], {"rotation_deg": 1.0}),
    "sigma in another word": ("case", ["views", "AP", "sigma"], "free"),
    "negative sigma of a camera": (
        "case",
        ["views", "AP", "sigma"],
        {"rotation_deg": -1.0, "translation_mm": 0.0, "focal_percent": 0.0, "principal_point_px": 0.0},
    ),
    "sigma of a camera that is none": (
        "case",
        ["views", "AP", "sigma"],
        {"rotation_deg": 21.0, "translation_mm": 0.0, "focal_percent": 0.0, "principal_point_px": 0.0},
    ),
    "refined camera without its matrix": ("result", ["cameras"], {"AP": {"rotation_deg": 1.0}}),
    "empty view name": ("case", ["annotations", ""], []),
    "unit of the moon": ("case", ["models", "ms65x45", "unit"], "ell"),
    "four quantiles": ("summary", ["sets", "pairs", "methods", "default", "tip_mm", "p95"], None),
    "half a case": ("summary", ["sets", "pairs", "methods", "default", "cases"], 0.5),
    "share above 1": ("summary", ["sets", "pairs", "methods", "default", "pairing", "right"], 1.01),
}


@pytest.mark.parametrize("name", REFUSED)
def test_models_and_schemas_refuse_the_same(name):
    kind, keys, value = REFUSED[name]
    data = changed(kind, keys, value)
    assert faults(data, schema_documents()[kind]) != []
    with pytest.raises(ValidationError):
        MODEL_OF[kind].model_validate(data)


# What a schema cannot say and the reader refuses, with its words.
SCALED = [[1.001, 0, 0, 0], [0, 1.001, 0, 0], [0, 0, 1.001, 0], [0, 0, 0, 1]]
SHEARED = [[1, 0.01, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
MIRRORED = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
POSES = {
    "scaled": (
        SCALED,
        r"the pose is not rigid: R\^T R differs from the identity by 0\.002; expected at most 1e-06\.",
    ),
    "sheared": (SHEARED, r"the pose is not rigid: R\^T R differs from the identity by 0\.01"),
    "mirrored": (MIRRORED, r"the pose is a reflection: det R = -1; expected a rotation, det R = \+1\."),
    "transposed": (
        np.array(ROLL_90).T.tolist(),
        r"the last row of a pose is \[10\.0, -20\.0, 5\.0, 1\.0\]; expected \[0, 0, 0, 1\]\. If the .* is transposed\.",
    ),
    "three rows": (ROLL_90[:3], r"has 3 rows of 4; expected 4 rows of 4 numbers\. Add the last row \[0, 0, 0, 1\]\."),
}


@pytest.mark.parametrize("name", POSES)
@pytest.mark.parametrize(
    ("kind", "keys", "field"),
    [
        ("truth", ["screws", 0, "world_from_cad"], r"screws\[0\]\.world_from_cad"),
        ("truth", ["screws", 0, "parts", "tower"], r"screws\[0\]\.parts\.tower"),
        ("result", ["screws", 0, "parts", "shank", "world_from_cad"], r"screws\[0\]\.parts\.shank\.world_from_cad"),
    ],
)
def test_poses_must_be_rigid(tmp_path, name, kind, keys, field):
    pose, said = POSES[name]
    path = tmp_path / f"{kind}.json"
    path.write_text(json.dumps(changed(kind, keys, pose)))
    with pytest.raises(CaseError, match=rf"{kind}\.json: {field}: {said}"):
        (read_truth if kind == "truth" else read_result)(path)


def test_a_rigid_pose_is_taken(tmp_path):
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(changed("truth", ["screws", 0, "world_from_cad"], ROLL_90)))
    assert read_truth(tmp_path).screws[0].world_from_cad == tuple(map(tuple, ROLL_90))


RESULTS = {
    "axis of length 2": (
        ["screws", 0, "axis"],
        [0, 2, 0],
        r"screws\[0\]\.axis: the vector has length 2; expected a",
    ),
    "covariance not symmetric": (
        ["screws", 0, "sigma", "tip_covariance_mm2"],
        [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]],
        r"screws\[0\]\.sigma\.tip_covariance_mm2: the matrix is no covariance; expected a symmetric matrix without",
    ),
    "covariance negative": (
        ["screws", 0, "sigma", "tip_covariance_mm2"],
        [[1, 2, 0], [2, 1, 0], [0, 0, 1]],  # eigenvalues 3, -1, 1
        r"screws\[0\]\.sigma\.tip_covariance_mm2: the matrix is no covariance",
    ),
    "chosen combination is not there": (
        ["pairing", "chosen_by", "post"],
        7,
        r"result\.json: pairing\.chosen_by\.post is 7; expected the id of a combination, one of \[1\]\.",
    ),
    "refused with screws": (
        ["status"],
        "refused",
        r"a refused result has 1 screws and 0 warnings; expected no screws, and a warning that says why\.",
    ),
    "probability": (["pairing", "probability"], 1.5, r"pairing\.probability: 1\.5; expected 0 to 1\."),
    "loss": (["combinations", 0, "pre", "loss"], -2, r"combinations\[0\]\.pre\.loss: -2; expected -1 to 1\."),
    "id": (["combinations", 0, "id"], 0, r"combinations\[0\]\.id: 0; expected 1 or more\."),
    "unknown key": (
        ["combination"],
        [],
        r"combination: unknown key `combination`; the nearest known one is `combin",
    ),
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_bad_result_is_refused_in_words(tmp_path, name):
    keys, value, said = RESULTS[name]
    (tmp_path / "result.json").write_text(json.dumps(changed("result", keys, value)))
    with pytest.raises(CaseError, match=said):
        read_result(tmp_path)


def test_two_combinations_of_one_id_are_refused():
    data = example("result")
    data["combinations"] *= 2
    with pytest.raises(ValidationError, match=r"the combinations have the ids \[1, 1\]; expected each id once"):
        models.ResultFile.model_validate(data)


def test_a_refusal_needs_no_more_than_its_reason():
    data = example("result")
    data |= {"status": "refused", "screws": [], "combinations": [], "warnings": ["The views are parallel."]}
    data["pairing"] = {"status": "refused", "pairs": [], "unpaired": {"AP": ["1"], "LAT": ["a"]}}
    assert faults(data, schema_documents()["result"]) == []
    assert models.ResultFile.model_validate(data).pairing.probability is None


def test_files_are_read_and_written_by_name_or_folder(tmp_path):
    result = models.ResultFile.model_validate(example("result"))
    assert write_result(tmp_path, result) == tmp_path / "result.json"
    assert read_result(tmp_path / "result.json") == read_result(tmp_path) == result
    truth = models.TruthFile.model_validate(example("truth"))
    assert write_truth(tmp_path, truth) == tmp_path / "truth.json"
    assert read_truth(tmp_path) == truth
    summary = models.SummaryFile.model_validate(example("summary"))
    assert write_summary(tmp_path, summary) == tmp_path / "summary.json"
    assert read_summary(tmp_path) == summary
    # Absent, not null: what was not estimated leaves no trace.
    for name in ("result", "truth", "summary"):
        assert "null" not in (tmp_path / f"{name}.json").read_text()
        assert json.loads((tmp_path / f"{name}.json").read_text()) == example(name)


def test_the_wrong_file_is_named(tmp_path):
    path = tmp_path / "case.json"
    path.write_text(json.dumps(example("case")))
    with pytest.raises(CaseError, match=r'format: "screwpose-case/1"; expected "screwpose-result/1"\. This is a case'):
        read_result(path)
    path.write_text("[1, 2]")
    with pytest.raises(CaseError, match=r"the file holds \[1, 2\]; expected an object, \{ \}, with \"format\""):
        read_truth(path)


def test_the_contracts_case_is_refused_for_its_zeros_and_files(tmp_path):
    """Its matrices are placeholders of the right shape: the schema takes them, the reader does not."""
    (tmp_path / "case.json").write_text(json.dumps(example("case")))
    case, findings = inspect_case(tmp_path)
    assert case is None
    fields = {finding.field for finding in errors_in(findings)}
    assert {"views.AP.projection", "views.LAT.projection", "views.AP.image", "models.ms65x45.mesh"} <= fields


def test_models_cannot_be_changed():
    sigma = models.SigmaFile(tip_mm=0.1)
    with pytest.raises(ValidationError, match="frozen"):
        sigma.tip_mm = 0.2


def test_rounding_does_not_cost_a_result():
    scores = models.Scores(dice=1.0 + 1e-12, loss=-1.0 - 1e-12)
    assert (scores.dice, scores.loss) == (1.0, -1.0)


def test_numpy_values_can_be_handed_over():
    angle = 0.3
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    part = models.PartPose(world_from_cad=models.as_pose(pose))
    np.testing.assert_array_equal(part.world_from_cad, pose)
    assert models.PartPose.model_validate({"world_from_cad": pose}) == part
    assert models.as_point3(np.array([1, 2, 3])) == (1.0, 2.0, 3.0)
    assert models.as_matrix3x3(np.eye(3)) == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert models.as_matrix3x4(np.eye(4)[:3])[2] == (0.0, 0.0, 1.0, 0.0)
    assert models.SigmaFile(tip_mm=np.float32(0.5)).tip_mm == 0.5
    with pytest.raises(ValidationError):
        models.SigmaFile(tip_mm=float("nan"))


def test_the_oracle_can_see_a_fault():
    document = copy.deepcopy(schema_documents()["truth"])
    document["required"].append("extra")
    assert faults(example("truth"), document) == [".extra: required"]
