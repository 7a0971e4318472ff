"""Every example that the pages print is run, or held against its format."""

import doctest
import json

import pytest

from screwpose.files import schema_documents
from screwpose.files.schema import CaseFile, ResultFile, SummaryFile, TruthFile
from tests.docs.pages import NAMES, PAGES, blocks
from tests.files.plain_validator import faults

TEXTS = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
MODELS = {"case": CaseFile, "truth": TruthFile, "result": ResultFile, "summary": SummaryFile}
PYTHON = [name for name in NAMES if blocks(TEXTS[name], "python")]
SESSIONS = [name for name in NAMES if blocks(TEXTS[name], "pycon")]


def examples_in(name):
    return blocks(TEXTS[name], "json")


def test_the_pages_with_examples_are_the_ones_that_we_think():
    assert PYTHON == ["benchmarking.md", "errors.md", "files.md", "quickstart.md"]
    assert SESSIONS == ["conventions.md"]


@pytest.mark.parametrize("name", PYTHON)
def test_python_examples_run(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    known = {"__name__": "__main__"}
    found = blocks(TEXTS[name], "python")
    assert any("assert " in block.text for block in found)
    for block in found:
        # Empty lines in front: an error then names the page's own line.
        exec(compile("\n" * (block.line - 1) + block.text, name, "exec"), known)


@pytest.mark.parametrize("name", SESSIONS)
def test_sessions_give_what_they_show(name):
    session = "".join(block.text + "\n" for block in blocks(TEXTS[name], "pycon"))
    test = doctest.DocTestParser().get_doctest(session, {}, name, name, 0)
    assert len([example for example in test.examples if example.want]) >= 15
    told = []
    result = doctest.DocTestRunner().run(test, out=told.append)
    assert result.failed == 0, "".join(told)
    assert result.attempted == len(test.examples)


def test_no_example_is_left_out():
    # A language that is misspelt or not known here would never run.
    known = {"sh", "text", "json", "python", "pycon"}
    for name, text in TEXTS.items():
        fences = [line.strip() for line in text.splitlines() if line.strip().startswith("```")]
        opened = [fence.removeprefix("```") for fence in fences[::2]]
        assert set(opened) <= known, name
        assert len(fences) == 2 * len(blocks(text, *known)), name


def test_json_examples_hold_to_their_formats():
    kinds = []
    documents = schema_documents()
    for name in NAMES:
        for block in examples_in(name):
            data = json.loads(block.text)
            kind = data["format"].removeprefix("screwpose-").removesuffix("/1")
            kinds.append((name, kind))
            MODELS[kind].model_validate(data)
            assert faults(data, documents[kind]) == [], (name, kind)
    assert kinds == [
        ("README.md", "case"),
        *(("files.md", kind) for kind in ("case", "truth", "result", "summary")),
    ]


def test_the_readmes_case_is_the_worked_example():
    # Its landmarks fit its matrices and its model: a reader who tries it is not refused.
    import numpy as np

    from screwpose.geometry import Camera
    from screwpose.pairing import LandmarkNoise, fit_segment

    for name in ("README.md", "files.md"):
        data = json.loads(examples_in(name)[0].text)
        cameras = [Camera.from_matrix(np.array(view["projection"]), (1024, 1024)) for view in data["views"].values()]
        marks = [data["annotations"][view][0] for view in data["views"]]
        tips, centers = (np.array([mark[key] for mark in marks]) for key in ("tip", "center"))
        (model,) = data["models"].values()
        length_mm = float(np.linalg.norm(np.subtract(model["center"], model["tip"])))
        fit = fit_segment(cameras, tips, centers, length_mm, LandmarkNoise())
        np.testing.assert_allclose(fit.tip_mm, [12.0, 0.0, 30.0], atol=0.02)
        np.testing.assert_allclose(fit.center_mm, [12.0, 18.0, 43.5], atol=0.02)
        assert fit.chi_square < 0.01
