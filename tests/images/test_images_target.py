"""The metal target against exact masks of drawn scenes, and against the real knees' labels."""

import time

import cv2
import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from screwpose.images import field_of_view, metal_target, read_mask, read_radiograph
from tests.data import shared_data
from tests.images.scenes import dice, exposed, grid, rod, spine_with_screws


def near(mask: np.ndarray, margin_px: int) -> np.ndarray:
    size = 2 * margin_px + 1
    return cv2.dilate(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0


@pytest.mark.parametrize("seed", [0, 3])
def test_screws_with_pale_towers_over_gradients(seed: int) -> None:
    grey, mask = spine_with_screws(seed)
    everywhere = np.ones_like(mask)
    assert dice(metal_target(1 - grey, everywhere), mask) > 0.8
    assert dice(metal_target(1 - grey, everywhere, near(mask, 25)), mask) > 0.88


def test_a_threshold_would_not_do() -> None:
    """The scene is a test: no grey level of the image comes near."""
    grey, mask = spine_with_screws(0)
    assert max(dice(grey < level, mask) for level in np.linspace(0.02, 0.98, 60)) < 0.6


@pytest.mark.parametrize("radius_px", [6, 12, 60, 100])
def test_thin_and_thick(radius_px: int) -> None:
    u, _ = grid(768)
    attenuation = 0.4 + 1.2 * u / 768 + rod(768, (200, 300), (560, 420), radius_px) * (2.0 / radius_px)
    mask = rod(768, (200, 300), (560, 420), radius_px) > 0
    grey = exposed(attenuation, np.random.default_rng(radius_px))
    assert dice(metal_target(1 - grey, np.ones_like(mask)), mask) > 0.95


def test_region_and_hint_are_kept_to() -> None:
    grey, mask = spine_with_screws(1)
    u, _ = grid(768)
    region = u < 450
    found = metal_target(1 - grey, region)
    assert found.any()
    assert not found[~region].any()
    v = grid(768)[1]
    upper = near(mask, 20) & (v < 330)
    found = metal_target(1 - grey, np.ones_like(mask), upper)
    assert not found[~upper].any()
    assert dice(found, mask & upper) > 0.9
    assert not metal_target(1 - grey, np.zeros_like(mask)).any()


def test_polarity_of_contrast_matters() -> None:
    """A bright slit is no metal."""
    u, _ = grid(512)
    grey = exposed(1.0 - 0.8 * (abs(u - 256) < 8), np.random.default_rng(0))
    found = metal_target(1 - grey, np.ones(u.shape, dtype=bool))
    assert not found[:, 250:263].any()
    assert found.mean() < 0.02


def test_plain_image_has_no_metal() -> None:
    assert not metal_target(np.full((300, 300), 0.5, np.float32), np.ones((300, 300), bool)).any()


SINGLE = [f"AT_K1_V1_{i:04d}" for i in (160, 170, 180)] + [f"HL_V1_K1_{i:04d}" for i in (1, 19, 37, 55, 73, 91)]


@pytest.mark.parametrize("name", SINGLE[::2])
def test_real_knees(name: str) -> None:
    """Thick cobalt-chrome, table and markers about: with a hint of 30 px round the labels of femur and tibia."""
    radiograph = read_radiograph(shared_data(f"jtml_single/images/{name}.png"), "metal-dark")
    labels = [
        read_mask(shared_data(f"jtml_single/labels/{name}_{bone}.png"), (1024, 1024)) for bone in ("femur", "tibia")
    ]
    mask = labels[0] | labels[1]
    found = metal_target(radiograph.pixels, field_of_view(radiograph), near(mask, 30))
    assert dice(found, mask) > 0.85
    assert binary_dilation(found, iterations=3)[mask].mean() > 0.8


def test_quick_enough() -> None:
    """Some 0.3 s of one core for 1024 x 1024 with a hint, twice that without; the bound allows for slower machines."""
    grey, mask = spine_with_screws(2, 1024)
    hint = near(mask, 30)
    metal_target(1 - grey, np.ones_like(mask), hint)
    started = time.process_time()
    metal_target(1 - grey, np.ones_like(mask), hint)
    assert time.process_time() - started < 1.5
