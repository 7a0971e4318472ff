"""The field of view against shapes drawn by formula and against discs fitted to the real images by hand."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from screwpose.images import field_of_view, read_radiograph
from screwpose.images.field import _circles_through, _fit_circle
from screwpose.images.radiograph import Radiograph
from tests.data import shared_data
from tests.images.scenes import grid, rod, spine_with_screws

SIZE = 512
MARGIN_PX = 4  # 8 per 1024


def anatomy(seed: int) -> np.ndarray:
    """Attenuation in [0.1, 0.9]: tissue and air, no border."""
    u, _ = grid(SIZE)
    noise = np.random.default_rng(seed).standard_normal(u.shape)
    smooth = gaussian_filter(noise, 40) * 40
    image = 0.35 + 0.3 * (u > 180) + 0.12 * smooth + rod(SIZE, (200, 240), (380, 260), 9) / 60 + 0.01 * noise
    return np.clip(image, 0.1, 0.9)


def disc(u0: float, v0: float, radius: float) -> np.ndarray:
    u, v = grid(SIZE)
    return np.hypot(u - u0, v - v0) <= radius


def rectangle(angle_rad: float, half_width: float, half_height: float) -> np.ndarray:
    u, v = grid(SIZE)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    a, b = c * (u - 250) + s * (v - 260), -s * (u - 250) + c * (v - 260)
    return (abs(a) <= half_width) & (abs(b) <= half_height)


SHAPES = {
    "disc": disc(250, 262, 225),
    "disc cut by the image": disc(256, 256, 280),
    "upright rectangle": rectangle(0.0, 190, 150),
    "rotated rectangle": rectangle(0.3, 190, 140),
    "disc with a collimator blade": disc(256, 256, 240) & (grid(SIZE)[0] > 120),
}


def agreement_px(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """How far `found` reaches out of the truth, and how far it stays inside of it beyond the margin (px)."""
    from scipy.ndimage import distance_transform_edt

    padded_true = np.pad(true, 1, mode="edge")
    inward = distance_transform_edt(padded_true)[1:-1, 1:-1]
    outward = distance_transform_edt(~true)
    return float(np.max(outward * found)), float(np.max(inward * (true & ~found)) - MARGIN_PX)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("border", [1.0, 0.0], ids=["blocked beam", "blackened"])
def test_shapes(name: str, border: float) -> None:
    true = SHAPES[name]
    image = np.where(true, anatomy(1), border).astype(np.float32)
    found = field_of_view(image)
    assert found.dtype == np.bool_
    out_px, lost_px = agreement_px(found, true)
    assert out_px <= 1.0, "reaches out of the field"
    assert lost_px <= 3.0, "loses too much of the field"
    np.testing.assert_array_equal(field_of_view(Radiograph(image)), found)


def test_dense_tissue_and_metal_at_the_edge() -> None:
    """A tenth of the edge is as black as the border, and a rod leaves the field: the disc is completed."""
    true = disc(256, 256, 235)
    u, v = grid(SIZE)
    image = anatomy(2)
    image[np.hypot(u - 256, v - 20) < 70] = 1.0
    image[rod(SIZE, (300, 300), (500, 330), 10) > 0] = 1.0
    out_px, lost_px = agreement_px(field_of_view(np.where(true, image, 1.0).astype(np.float32)), true)
    assert out_px <= 1.5
    assert lost_px <= 3.0


def test_flat_panel_is_all_field() -> None:
    assert field_of_view(anatomy(3).astype(np.float32)).all()
    ramp = np.tile(np.linspace(0, 1, SIZE), (SIZE, 1)).astype(np.float32)
    assert field_of_view(ramp).all()
    assert field_of_view(np.full((SIZE, SIZE), 0.5, dtype=np.float32)).all()
    grey, _ = spine_with_screws(0)
    assert (grey == 1).mean() > 0.05, "the scene has saturated air"
    assert field_of_view(1 - grey).all()


@pytest.mark.parametrize("half_width_px", [75, 150])
@pytest.mark.parametrize("metal_bright", [True, False])
def test_limb_in_a_saturated_beam_is_no_field(half_width_px: int, metal_bright: bool) -> None:
    u, _ = grid(SIZE)
    thickness_mm = 0.6 * 2 * np.sqrt(np.maximum(half_width_px**2 - (u - 250) ** 2, 0))
    grey = np.clip(1.3 * np.exp(-0.02 * thickness_mm), 0, 1)
    grey = gaussian_filter(grey, 1.0).astype(np.float32)
    assert (grey > 0.999).mean() > 0.2
    assert field_of_view(1 - grey if metal_bright else grey).all()


def test_rod_that_leaves_a_flat_panel() -> None:
    image = anatomy(4).astype(np.float32)
    image[rod(SIZE, (200, 250), (600, 280), 14) > 0] = 1.0
    assert field_of_view(image).all()


@pytest.mark.parametrize("name", [f"{i:03d}_{view}" for i in (0, 64) for view in "AB"])
def test_real_biplane(name: str) -> None:
    """The same intensifiers in all pairs: read off the files, the edge lies 495 to 540 px from the image's centre."""
    found = field_of_view(read_radiograph(shared_data(f"jtml_biplane/images/{name}.png"), "metal-dark"))
    u, v = grid(1024)
    distance = np.hypot(u - 512, v - 511)
    assert found[distance < 485].all()
    assert not found[distance > 545].any()


@pytest.mark.parametrize(
    ("name", "transposed"), [("AT_K1_V1_0160", False), ("AT_K1_V1_0180", False), ("HL_V1_K1_0037", True)]
)
def test_real_collimated(name: str, transposed: bool) -> None:
    """Black bars on two sides; read off the files, the first and last rows (columns) with light are 117 and 906."""
    found = field_of_view(read_radiograph(shared_data(f"jtml_single/images/{name}.png"), "metal-dark"))
    found = found.T if transposed else found
    assert found[117 + 14 : 906 - 13].all()
    assert not found[: 117 + 2].any()
    assert not found[906 - 1 :].any()


def test_circles_through_three_points_are_those_of_the_fit() -> None:
    triples = np.random.default_rng(0).uniform(0, 1000, (50, 3, 2))
    triples[7] = [[0, 0], [10, 20], [30, 60]]  # on a line
    want = [circle for circle in map(_fit_circle, triples) if circle is not None]
    assert len(want) == 49
    np.testing.assert_allclose(_circles_through(triples), want, rtol=1e-6)
    u, v, radius = want[0]
    np.testing.assert_allclose(np.hypot(*(triples[0] - (u, v)).T), radius, rtol=1e-9)
