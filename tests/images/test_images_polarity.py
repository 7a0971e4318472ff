"""Polarity of every real image at hand, as it is and inverted, and of scenes drawn by formula."""

from pathlib import Path

import numpy as np
import pytest

from screwpose.images import detect_polarity, field_of_view, read_radiograph
from tests.data import shared_data
from tests.images.scenes import grid, spine_with_screws


def shown(path: Path) -> np.ndarray:
    return 1 - read_radiograph(path, "metal-dark").pixels


def biplane() -> list[Path]:
    return sorted((shared_data("jtml_biplane") / "images").glob("*.png"))[::8]


def test_biplane_both_ways() -> None:
    files = biplane()
    assert len(files) == 4
    for path in files:
        grey = shown(path)
        as_it_is, inverted = detect_polarity(grey), detect_polarity(1 - grey)
        assert (as_it_is.polarity, as_it_is.decided) == ("metal-dark", True), path
        assert (inverted.polarity, inverted.decided) == ("metal-bright", True), path
        blackened = detect_polarity(np.where(field_of_view(grey), 1 - grey, 0))
        assert (blackened.polarity, blackened.decided) == ("metal-bright", True), path


def test_single_view_is_never_surely_wrong() -> None:
    """Knees before a table whose bright slit is as striking as an implant: undecided is right, wrong is not."""
    files = sorted((shared_data("jtml_single") / "images").glob("*.png"))
    assert len(files) == 9
    for path in files[::3]:
        grey = shown(path)
        for image, truth in ((grey, "metal-dark"), (1 - grey, "metal-bright")):
            found = detect_polarity(image)
            assert found.polarity == truth or not found.decided, path


def test_images_are_read_with_metal_bright() -> None:
    """Through the reader: the open beam, saturated in the file, is 0."""
    for path in biplane():
        radiograph = read_radiograph(path)
        assert np.mean(radiograph.pixels == 0) > 0.2
        assert radiograph.notes == ()


@pytest.mark.parametrize("seed", [0, 2])
def test_screws_with_towers(seed: int) -> None:
    grey, mask = spine_with_screws(seed)
    assert grey[mask].mean() < 0.8 * grey[~mask].mean(), "the scene has dark metal"
    found = detect_polarity(grey)
    assert (found.polarity, found.decided) == ("metal-dark", True)
    opposite = detect_polarity(1 - grey)
    assert (opposite.polarity, opposite.decided) == ("metal-bright", True)
    np.testing.assert_allclose(opposite.score, -found.score, rtol=0.05)


def test_content_alone_decides() -> None:
    """No border and no saturated beam in the picture: it is the implants that tell."""
    grey, _ = spine_with_screws(4)
    cut = grey[:, :600]
    assert cut.max() < 1
    found = detect_polarity(cut)
    assert (found.polarity, found.decided) == ("metal-dark", True)
    knee = shown(shared_data("jtml_biplane/images/000_B.png"))[440:860, 460:760]
    assert (knee < 1).mean() > 0.98
    found = detect_polarity(knee)
    assert (found.polarity, found.decided) == ("metal-dark", True)


def test_white_border_says_inverted() -> None:
    grey, _ = spine_with_screws(3, 512)
    u, v = grid(512)
    inside = np.hypot(u - 205, v - 256) < 195  # all of it in the body: no open beam beside the white border
    plain = detect_polarity(np.where(inside, grey, 0).astype(np.float32))
    white = detect_polarity(np.where(inside, grey, 1).astype(np.float32))
    assert plain.score - white.score == pytest.approx(2.3, abs=0.1)


def test_nothing_to_see_is_undecided() -> None:
    assert not detect_polarity(np.full((200, 300), 0.5, dtype=np.float32)).decided
    ramp = np.tile(np.linspace(0, 1, 256), (256, 1)).astype(np.float32)
    assert not detect_polarity(ramp).decided
    noise = np.random.default_rng(0).uniform(0.3, 0.7, (400, 400)).astype(np.float32)
    assert not detect_polarity(noise).decided
