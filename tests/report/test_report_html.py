"""The page: self-contained, escaped, complete."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from screwpose.files.case import Annotation
from screwpose.report.comparison import Comparison, ScrewComparison
from screwpose.report.drawings import draw
from screwpose.report.html import report_html
from screwpose.report.palette import Palette
from screwpose.report.space import arrange
from screwpose.report.words import pairing_story, percent
from tests.report.scene import make_case, make_refused, make_result

VOID = {"meta", "input", "img", "br", "link", "hr"}
EVIL = "<script>alert(1)</script>\"'&"


class Page(HTMLParser):
    """Tags, their attributes and the visible text of a page; asserts that tags are closed in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.words = [], [], []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def html_of(case, result, comparison=None):
    palette = Palette.of_case(case)
    drawings = draw(case, result, palette, comparison)
    return report_html(
        case, result, drawings, arrange(case, result, drawings, palette, comparison), palette, comparison
    )


def relabelled(case, truth, label):
    """The case and truth with the first AP screw called `label`."""
    marks = {name: list(one) for name, one in case.annotations.items()}
    first = marks["AP"][0]
    marks["AP"][0] = Annotation(label, first.tip_px, first.center_px, first.model)
    truth = [replace(truth[0], labels={**truth[0].labels, "AP": label}), *truth[1:]]
    return replace(case, annotations={name: tuple(one) for name, one in marks.items()}), truth


@pytest.fixture(scope="module")
def confident():
    case, truth = make_case((320, 240))
    comparison = Comparison(
        (
            ScrewComparison({"AP": "1", "LAT": "a"}, True, 0.1234, 0.08, None, 0.11, -1.3),
            ScrewComparison({"AP": "2", "LAT": "b"}, False),
        ),
        tuple(one.labels for one in truth),
        tuple(truth),
        "simulated",
    )
    return html_of(case, make_result(case, truth), comparison)


def test_the_page_asks_the_network_for_nothing(confident):
    page = Page(confident)
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base", "a")
        for name in ("src", "href", "xlink:href", "action", "data", "srcset", "poster"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, name)
    policy = next(a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; img-src data: blob:;")
    assert not re.search(
        r"@import|url\(\s*['\"]?(?!data:)[a-z/]", re.search(r"<style>(.*?)</style>", confident, re.S)[1]
    )
    # The one address in the bundled script is a namespace, which nothing fetches.
    assert set(re.findall(r"https?://[^\s\"'`<>)]+", confident)) == {"http://www.w3.org/1999/xhtml"}


def test_the_page_is_a_few_megabytes_at_most():
    case, truth = make_case((1024, 1024))
    assert len(html_of(case, make_result(case, truth))) < 4_000_000


def test_the_page_says_what_it_must(confident):
    text = Page(confident).text
    for words in (
        "Confident",
        "not a medical device",
        "Probability that the pairing is right: 99.8 %.",
        "The higher Dice score before registration names combination 1 (0.860, the best other one 0.600).",
        "AP: read as metal-dark.",
        "tip 0.08 mm, axis 0.1°, roll 0.9°",
        "not estimated",
        "1 (chosen, correct): AP 1 / LAT a, AP 2 / LAT b",
        "2 (rejected, wrong): AP 1 / LAT b, AP 2 / LAT a",
        "Dice 0.920, loss -0.410",
        "screwpose 0.1.0",
        "registration 0.60",
        "Truth: simulated.",
        "0.123 0.080 - 0.110 -1.30",
        "[-10.000, 20.000, -3.000]",
        "offers no WebGL",
    ):
        assert words in text, words


def test_the_matrix_can_be_copied_as_json(confident):
    _, truth = make_case((320, 240))
    block = re.search(r'<pre id="matrix-1-0"[^>]*>(.*?)</pre>', confident, re.S)[1]
    np.testing.assert_allclose(json.loads(block), truth[1].world_from_cad, atol=1e-8)
    assert 'data-copy="matrix-1-0"' in confident


def test_every_layer_scene_and_stage_can_be_chosen(confident):
    page = Page(confident)
    layers = [attributes["data-layer"] for _, attributes in page.tags if "data-layer" in attributes]
    assert layers == ["xray", "fill", "outline", "landmarks", "clicks", "labels", "truth"]
    groups = [a["data-scene"] for tag, a in page.tags if tag == "g" and "data-scene" in a]
    assert groups == ["1-pre", "1-post", "2-pre", "2-post"] * 2
    shown = {a["data-scene"] for tag, a in page.tags if "data-scene" in a and "hidden" not in a}
    assert shown == {"1-post"}
    data = json.loads(re.search(r'id="space-data">(.*?)</script>', confident, re.S)[1])
    assert data["first"] == "1-post"


@pytest.mark.parametrize("place", ["label", "warning", "case", "model", "view"])
def test_text_from_the_case_is_never_markup(place):
    case, truth = make_case()
    if place == "label":
        case, truth = relabelled(case, truth, EVIL)
    result = make_result(case, truth, **({"warnings": [EVIL]} if place == "warning" else {}))
    if place == "case":
        case = replace(case, id=EVIL)
        result = make_result(case, truth)
    if place == "model":
        case = replace(case, implants={**case.implants, EVIL: case.implants["rod"]})
        screws = [one.model_dump() | {"model": EVIL} for one in result.answer.screws]
        result = make_result(case, truth, screws=screws)
    if place == "view":
        screws = [one.model_dump() | {"labels": {EVIL: "1"}} for one in result.answer.screws]
        result = make_result(case, truth, screws=screws)
    html = html_of(case, result)
    assert "<script>alert" not in html
    page = Page(html)
    assert EVIL in page.text
    assert len([tag for tag, _ in page.tags if tag == "script"]) == 3
    json.loads(re.search(r'id="space-data">(.*?)</script>', html, re.S)[1])


def test_a_refused_answer_shows_the_landmarks_and_the_reason():
    case, _ = make_case()
    html = html_of(case, make_refused(case))
    page = Page(html)
    assert "Refused" in page.text
    assert "the rays miss each other by 14 mm." in page.text
    assert len([tag for tag, _ in page.tags if tag == "image"]) == 2
    assert [a["data-layer"] for _, a in page.tags if "data-layer" in a] == ["xray", "clicks", "labels"]
    assert "Without a partner: AP 1, AP 2, LAT a, LAT b." in page.text
    assert 'id="space"' not in html
    assert "ScrewposeViewer=" not in html


def test_a_pairing_whose_status_differs_says_so_and_no_probability_is_made_up():
    case, truth = make_case()
    plain = make_result(case, truth)
    pairing = plain.answer.pairing.model_dump() | {"probability": None, "chosen_by": {"pre": 2, "post": 2}}
    result = make_result(case, truth, status="ambiguous", pairing=pairing, warnings=["look"])
    text = Page(html_of(case, result)).text
    assert "Ambiguous" in text
    assert "The pairing by itself is confident" in text
    assert "The method gives no probability for the pairing." in text
    assert "So the answer does not follow the Dice score" in text


def test_the_story_tells_of_stages_that_disagree():
    case, truth = make_case()
    pairing = make_result(case, truth).answer.pairing.model_dump() | {"chosen_by": {"pre": 2, "post": 1}}
    story = " ".join(pairing_story(case, make_result(case, truth, pairing=pairing).answer))
    assert "Dice before and after registration name different combinations" in story
    assert "does not follow" not in story


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.998, "99.8 %"),
        (0.5, "50.0 %"),
        (0.9995, "99.95 %"),
        (0.99999, "> 99.99 %"),
        (1.0, "100.00 %"),
        (1e-6, "< 0.01 %"),
    ],
)
def test_rounding_makes_no_certainty(probability, text):
    assert percent(probability) == text


def test_a_mask_can_be_looked_at():
    case, truth = make_case()
    mask = case.views["AP"].mask.copy()
    mask[:, :30] = False
    views = {**case.views, "AP": replace(case.views["AP"], mask=mask)}
    page = Page(html_of(replace(case, views=views), make_result(case, truth)))
    assert "mask" in [a.get("data-layer") for _, a in page.tags]
    assert len([a for tag, a in page.tags if a.get("class") == "layer-mask"]) == 1
