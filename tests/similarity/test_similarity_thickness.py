"""The thickness measure: derivatives of known images, a response that is recovered, energies between 0 and 1."""

import numpy as np
import pytest

from screwpose.errors import ImageError
from screwpose.geometry import Camera
from screwpose.similarity.thickness import derivatives, explain, localised, make_gradient_target, response_slope

SHAPE = (120, 160)
CAMERA = Camera.from_matrix(np.array([[400.0, 0, 80, 0], [0, 400.0, 60, 0], [0, 0, 1, 0]]))
EVERYWHERE = np.ones(SHAPE, bool)
WHOLE = (slice(0, SHAPE[0]), slice(0, SHAPE[1]))
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]]


def dome(height_mm: float = 12.0) -> np.ndarray:
    return height_mm * np.sqrt(np.clip(1.0 - ((U - 80) / 35) ** 2 - ((V - 60) / 25) ** 2, 0.0, None))


def test_derivatives_of_a_plane_and_of_a_blurred_step() -> None:
    plane = (0.02 * U - 0.03 * V).astype(np.float32)
    target = make_gradient_target(plane, EVERYWHERE, CAMERA, 1)
    inner = (slice(10, -10), slice(10, -10))
    np.testing.assert_allclose(target.along_u[inner], 0.02, atol=1e-5)
    np.testing.assert_allclose(target.along_v[inner], -0.03, atol=1e-5)
    step = make_gradient_target((U >= 80).astype(np.float32), EVERYWHERE, CAMERA, 1, blur_px=2.0)
    # The derivative of a step is the Gaussian itself, its middle between the columns 79 and 80.
    want = np.exp(-0.5 * ((U[60] - 79.5) / 2.0) ** 2) / np.sqrt(2 * np.pi * 4.0)
    np.testing.assert_allclose(step.along_u[60], want, atol=3e-3)
    assert step.along_u[60].sum() == pytest.approx(1.0, abs=1e-3)  # cut off at four sigma


def test_an_even_slope_is_taken_off_and_an_edge_is_not() -> None:
    # Along the derivative's own direction: a slope that is even over 9 px is nothing, a sharp step hardly changes.
    plane = (0.02 * U - 0.03 * V).astype(np.float32)
    inner = (slice(10, -10), slice(10, -10))
    flat = make_gradient_target(plane, EVERYWHERE, CAMERA, 1, 0.7, mean_px=9)
    assert np.abs(flat.along_u[inner]).max() < 1e-6
    assert np.abs(flat.along_v[inner]).max() < 1e-6
    step = make_gradient_target((U >= 80).astype(np.float32), EVERYWHERE, CAMERA, 1, 0.7, mean_px=9)
    plain = make_gradient_target((U >= 80).astype(np.float32), EVERYWHERE, CAMERA, 1, 0.7)
    # A step of height 1 has a mean derivative of 1 / 9 over 9 px around it.
    np.testing.assert_allclose(step.along_u[60, 78:82], plain.along_u[60, 78:82] - 1.0 / 9.0, atol=1e-3)
    np.testing.assert_allclose(flat.differentiated(plane)[0], flat.along_u, atol=1e-7)
    # What counts stays clear of the border by as much further as the mean reaches.
    assert step.counts.sum() < plain.counts.sum()


def test_a_reduced_image_has_its_camera_reduced_with_it() -> None:
    target = make_gradient_target(np.zeros(SHAPE, np.float32), EVERYWHERE, CAMERA, 4)
    assert target.shape == (30, 40)
    # The centre of 4 x 4 pixels, 81.5 and 61.5, is the pixel (20, 15).
    point = CAMERA.ray_directions_in_world(np.array([[81.5, 61.5]]))[0]
    homogeneous = target.intrinsics @ (target.camera_from_world[:3, :3] @ point)
    np.testing.assert_allclose(homogeneous[:2] / homogeneous[2], [20.0, 15.0], atol=1e-9)
    with pytest.raises(ImageError, match="cannot be reduced 16 times"):
        make_gradient_target(np.zeros(SHAPE, np.float32), EVERYWHERE, CAMERA, 16)


def test_a_mirrored_view_is_mirrored_back() -> None:
    rng = np.random.default_rng(1)
    image = rng.random(SHAPE, dtype=np.float32)
    mirror = np.array([[-1.0, 0, SHAPE[1] - 1.0], [0, 1, 0], [0, 0, 1]])
    plain = make_gradient_target(image, EVERYWHERE, CAMERA, 2)
    turned = make_gradient_target(image[:, ::-1], EVERYWHERE, Camera(mirror @ CAMERA.projection), 2)
    np.testing.assert_allclose(turned.along_u, plain.along_u, atol=1e-6)
    np.testing.assert_allclose(
        turned.intrinsics @ turned.camera_from_world[:3], plain.intrinsics @ plain.camera_from_world[:3], atol=1e-9
    )


def test_a_response_of_its_own_family_is_recovered_behind_a_slope_and_outliers() -> None:
    lengths = dome()
    rng = np.random.default_rng(2)
    image = 0.5 * -np.expm1(-lengths / 2.0) + 0.3 * -np.expm1(-lengths / 15.0) + 0.002 * U + rng.normal(0, 0.002, SHAPE)
    image[40:44, 60:90] += 0.6  # a wire
    found = explain(make_gradient_target(image.astype(np.float32), EVERYWHERE, CAMERA, 1), lengths, WHOLE)
    # Neighbouring exponentials stand in for each other: the curve counts, not its weights.
    path = np.linspace(0, 12, 50)
    curve = sum(w * -np.expm1(-path / c) for w, c in zip(found.response, [0.7, 2, 6, 15, 40], strict=True))
    np.testing.assert_allclose(curve, 0.5 * -np.expm1(-path / 2) + 0.3 * -np.expm1(-path / 15), atol=0.03)
    assert 0.4 < found.energy < 0.97  # the wire is not explained
    clean = image - np.where((V >= 40) & (V < 44) & (U >= 60) & (U < 90), 0.6, 0.0)
    assert explain(make_gradient_target(clean.astype(np.float32), EVERYWHERE, CAMERA, 1), lengths, WHOLE).energy > 0.97
    on_wire = np.zeros(SHAPE, bool)
    on_wire[39:45, 65:85] = True
    assert np.median(found.weights[1][on_wire[found.near]]) < 0.2 < 0.8 < np.median(found.weights)


def test_nothing_in_view_and_a_model_in_the_wrong_place_explain_nothing() -> None:
    image = dome().astype(np.float32) / 20
    target = make_gradient_target(image, EVERYWHERE, CAMERA, 1)
    nothing = explain(target, np.zeros(SHAPE), WHOLE)
    assert nothing.energy == 0.0
    assert not nothing.near.any()
    aside = explain(target, np.roll(dome(), 60, axis=1) * (U > 100), WHOLE)
    assert aside.energy < 0.3 < 0.99 < explain(target, dome(), WHOLE).energy


def test_outside_the_region_nothing_counts() -> None:
    region = U < 80
    found = explain(make_gradient_target(dome().astype(np.float32) / 20, region, CAMERA, 1), dome(), WHOLE)
    assert found.near.any()
    assert U[found.near].max() < 80 - 5


def test_model_derivatives_by_a_parameter_are_differences_of_the_model() -> None:
    lengths = dome()
    image = (0.6 * -np.expm1(-lengths / 6.0)).astype(np.float32)
    target = make_gradient_target(image, EVERYWHERE, CAMERA, 1)
    found = explain(target, lengths, WHOLE)
    change = 0.01 * lengths * (1.0 + 0.01 * U)
    by_motion = np.stack([change, 2.0 * change], axis=2).astype(np.float32)
    slopes = derivatives(target, response_slope(found.response, lengths), by_motion)
    constants = np.array([0.7, 2.0, 6.0, 15.0, 40.0])

    def model(lengths_mm: np.ndarray) -> np.ndarray:
        shown = sum(w * -np.expm1(-lengths_mm / c) for w, c in zip(found.response, constants, strict=True))
        return np.stack(target.differentiated(np.asarray(shown, dtype=np.float32)))

    numeric = (model(lengths + 0.5 * change) - model(lengths - 0.5 * change)) / 1.0
    np.testing.assert_allclose(slopes[..., 0], numeric, atol=2e-6 + 0.02 * np.abs(numeric).max())
    np.testing.assert_allclose(slopes[..., 1], 2.0 * slopes[..., 0], atol=1e-6)


def test_gain_and_noise_of_each_place_are_found() -> None:
    """Twice the contrast on one side, three times the noise in one corner."""
    rng = np.random.default_rng(11)
    near = np.zeros((90, 120), bool)
    near[5:85, 5:115] = True
    rows, columns = np.nonzero(near)
    model = rng.normal(size=(2, len(rows)))
    noise = np.where((rows > 50) & (columns > 80), 0.3, 0.1)
    image = np.where(columns < 50, 2.0, 1.0) * model + noise * rng.normal(size=model.shape)
    gain, residuals, weights = localised(near, model.ravel(), image.ravel(), np.ones(model.size), 0.1)
    inside = (np.abs(columns - 50) > 8) & (columns > 15) & (columns < 105) & (rows > 15) & (rows < 75)
    assert np.mean(gain[inside & (columns < 50)]) == pytest.approx(1.9, abs=0.06)  # held a little to 1
    assert np.mean(gain[inside & (columns > 50)]) == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(residuals.reshape(2, -1), image - gain * model)
    trusted = np.median(weights.reshape(2, -1), axis=0)
    noisy = inside & (rows > 56) & (columns > 86)
    quiet = inside & (columns > 60) & (rows < 44)
    assert np.median(trusted[quiet]) / np.median(trusted[noisy]) == pytest.approx(9.0, rel=0.25)
