"""The simulator against gVXR, an X-ray simulator by others. Skipped where that is not installed.

What is independent: the tracer (OpenGL on the graphics stack), the geometry (source, detector and its axes, not a
projection matrix), the attenuation (gVXR's own tables, by element), and the sum over the spectrum (each keV, here six).
"""

from typing import Any

import numpy as np
import pytest

from screwpose.simulation import transmission
from screwpose.simulation.bodies import Body
from screwpose.simulation.materials import TITANIUM, EnergyBins, energy_bins
from screwpose.simulation.spectra import signal_spectrum, xray_tables
from tests.validation.gvxr_reference import Piece, gvxr_image, loaded_gvxr
from tests.validation.scenes import CAMERA, SIZE, TI_6AL_4V, ball, nested, off_edges, screw_and_ball, shift_px


@pytest.fixture(scope="module")
def gvxr() -> Any:
    try:
        return loaded_gvxr()
    except ImportError as error:
        pytest.skip(f"gVXR absent ({error}): see 'Against another simulator' in docs/simulation.md")


def single_energy(kev: float) -> EnergyBins:
    return EnergyBins(np.ones(1), np.array([int(np.argmin(np.abs(xray_tables().energy_kev - kev)))]))


@pytest.mark.parametrize("kev", [40.5, 60.5, 80.5])
@pytest.mark.parametrize("scene", [screw_and_ball(), nested()], ids=["in air", "nested"])
def test_one_energy(gvxr, scene, kev):
    bins = single_energy(kev)
    ours = transmission(scene.camera, scene.bodies, SIZE, 1, bins=bins)
    theirs = gvxr_image(gvxr, scene.camera, scene.pieces, bins.energies_kev, bins.weights)
    compared = off_edges(ours) & (ours > 1e-4)
    assert np.count_nonzero(compared & (ours < 0.9)) > 1000
    assert ours[compared].min() < 0.2
    assert np.abs(theirs / ours - 1.0)[compared].max() < 0.01
    assert np.abs(theirs - ours).mean() < 1e-3  # edges too


@pytest.mark.parametrize("scene", [screw_and_ball(), nested()], ids=["in air", "nested"])
def test_whole_spectrum_at_90_kv(gvxr, scene):
    ours = transmission(scene.camera, scene.bodies, SIZE, 1, bins=energy_bins(90.0))
    theirs = gvxr_image(gvxr, scene.camera, scene.pieces, xray_tables().energy_kev, signal_spectrum(90.0, 4.0, 0.1))
    compared = off_edges(ours) & (ours > 1e-4)
    assert np.count_nonzero(compared & (ours < 0.9)) > 1000
    assert np.abs(theirs / ours - 1.0)[compared].max() < 0.01
    without_hardening = transmission(scene.camera, scene.bodies, SIZE, 1, bins=single_energy(60.5))
    assert np.abs(theirs / without_hardening - 1.0)[compared].max() > 0.05  # the comparison can see it


def test_projection(gvxr):
    """A ball is where P says, and the whole image lies where the other simulator puts it."""
    bins = single_energy(60.5)
    v, u = np.indices(SIZE[::-1])
    for at in ((0.0, 0.0, 0.0), (30.0, 0.0, 25.0), (-35.0, 20.0, -28.0), (20.0, -30.0, -20.0)):
        one = ball(8.0, at, subdivisions=4)
        for image in (
            transmission(CAMERA, [Body(one, TITANIUM)], SIZE, 1, bins=bins),
            gvxr_image(gvxr, CAMERA, [Piece(one, TI_6AL_4V, 4.43)], bins.energies_kev, bins.weights),
        ):
            dark = 1.0 - image
            middle = np.array([(u * dark).sum(), (v * dark).sum()]) / dark.sum()
            assert np.linalg.norm(middle - CAMERA.project(np.array(at))) < 0.05
    scene = screw_and_ball()
    ours = transmission(CAMERA, scene.bodies, SIZE, 1, bins=bins)
    theirs = gvxr_image(gvxr, CAMERA, scene.pieces, bins.energies_kev, bins.weights)
    assert np.abs(shift_px(ours, theirs)).max() < 0.05
    assert shift_px(ours, np.roll(ours, 1, axis=1))[0] > 0.3  # the measure can see a shift
