"""Materials, and how well a few energies stand for a spectrum."""

import numpy as np
import pytest

from screwpose._types import FloatArray
from screwpose.simulation.materials import CORTICAL_BONE, GAS, MATERIALS, energy_bins, material
from screwpose.simulation.spectra import signal_spectrum, xray_tables

THICKEST_MM = {"titanium": 15.0, "PEEK": 30.0, "cobalt-chrome": 10.0, "steel": 10.0}


def line_integrals(count: int, rng: np.random.Generator) -> FloatArray:
    """(count, E): two soft tissues up to 35 cm in all, often some bone, mostly a metal."""
    result = []
    for _ in range(count):
        total = np.zeros(len(xray_tables().energy_kev))
        for name in rng.choice(["muscle", "fat", "viscera", "water", "blood"], 2):
            total += MATERIALS[name].linear_per_mm * rng.uniform(0.0, 175.0)
        if rng.random() < 0.7:
            total += CORTICAL_BONE.linear_per_mm * rng.uniform(0.0, 40.0)
        if rng.random() < 0.8:
            metal = str(rng.choice(list(THICKEST_MM)))
            total += MATERIALS[metal].linear_per_mm * THICKEST_MM[metal] * rng.random() ** 2
        result.append(total)
    return np.array(result)


MACHINES = [(50.0,), (70.0,), (80.0,), (92.5,), (110.0,), (125.0,), (85.0, 2.5, 0.0), (100.0, 6.0, 0.3)]
MACHINES += [(77.0, 4.0, 0.1, "Gd2O2S", 0.15)]


@pytest.mark.parametrize("machine", MACHINES, ids=str)
def test_six_energies_stand_for_the_spectrum(machine):
    """Within 0.5 % of the full grid wherever a ten-thousandth comes through; nothing was fitted to these mixtures."""
    integrals = line_integrals(1500, np.random.default_rng(11))
    full = signal_spectrum(*machine)
    bins = energy_bins(*machine)
    exact = np.exp(-integrals) @ full
    matters = exact > 1e-4
    assert 300 < matters.sum() < 1500
    got = np.exp(-integrals[:, bins.index]) @ bins.weights
    assert np.abs(got / exact - 1.0)[matters].max() < 5e-3
    assert len(bins.index) <= 6
    assert bins.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.all(bins.weights > 0.0)


def test_equal_bins_would_not_do():
    """The measure sees it: six bins of equal signal, each by its mean energy, are wrong by tens of per cent."""
    integrals = line_integrals(1500, np.random.default_rng(11))
    full, energy = signal_spectrum(90.0), xray_tables().energy_kev
    part = np.minimum((6.0 * np.cumsum(full)).astype(int), 5)
    weights = np.bincount(part, full)
    index = np.searchsorted(energy, np.bincount(part, full * energy) / weights)
    exact = np.exp(-integrals) @ full
    error = np.abs(np.exp(-integrals[:, index]) @ weights / exact - 1.0)[exact > 1e-4].max()
    assert error > 0.1
    better = energy_bins(90.0, count=8)
    assert np.abs(np.exp(-integrals[:, better.index]) @ better.weights / exact - 1.0)[exact > 1e-4].max() < 2e-3


def test_bins_read_the_materials_at_their_energies():
    bins = energy_bins(90.0)
    np.testing.assert_array_equal(
        MATERIALS["steel"].attenuation_per_mm_in(bins), MATERIALS["steel"].linear_per_mm[bins.index]
    )
    np.testing.assert_array_equal(bins.energies_kev, xray_tables().energy_kev[bins.index])
    assert np.all(np.diff(bins.energies_kev) > 0.0)


def test_linear_attenuation_by_hand():
    """At 60 keV: NIST's cm^2/g times g/cm^3 over ten."""
    at_60 = {name: np.exp(np.log(item.linear_per_mm[49:51] + 1e-300).mean()) for name, item in MATERIALS.items()}
    np.testing.assert_allclose(xray_tables().energy_kev[49:51].mean(), 60.0)
    assert at_60["water"] == pytest.approx(0.02059, rel=2e-3)
    assert at_60["muscle"] == pytest.approx(0.2048 * 1.05 / 10.0, rel=2e-3)
    assert at_60["cortical bone"] == pytest.approx(0.3148 * 1.92 / 10.0, rel=2e-3)
    # Ti 0.7661, Al 0.2778, V 0.8438 (xraylib): Ti-6Al-4V.
    assert at_60["titanium"] == pytest.approx((0.90 * 0.7661 + 0.06 * 0.2778 + 0.04 * 0.8438) * 4.43 / 10.0, rel=2e-3)
    # Polyetheretherketone, C19 H12 O3: NIST's C 0.1753, H 0.3260, O 0.1907.
    assert at_60["PEEK"] == pytest.approx((0.7915 * 0.1753 + 0.0420 * 0.3260 + 0.1665 * 0.1907) * 1.30 / 10.0, rel=3e-3)
    # 316L: Fe 1.205, Cr 0.9639, Ni 1.512, Mo 4.274, Mn 1.060.
    steel = 0.635 * 1.205 + 0.175 * 0.9639 + 0.14 * 1.512 + 0.03 * 4.274 + 0.02 * 1.060
    assert at_60["steel"] == pytest.approx(steel * 8.0 / 10.0, rel=4e-3)
    assert not GAS.linear_per_mm.any()


def test_materials_come_in_the_order_of_their_density_in_x_rays():
    names = [
        "gas", "lung", "fat", "water", "muscle", "cancellous bone", "cortical bone", "aluminium", "titanium", "steel",
        "lead",
    ]  # fmt: skip
    at_70 = [MATERIALS[name].linear_per_mm[60] for name in names]
    assert np.all(np.diff(at_70) > 0.0)
    assert {"PEEK", "carbon fibre", "blood", "skin", "viscera", "disc", "cobalt-chrome"} <= set(MATERIALS)


def test_bad_materials_and_counts_are_refused():
    with pytest.raises(ValueError, match=r"the mass fractions of alloy add up to 0\.9, expected 1"):
        material("alloy", 4.4, {"Ti": 0.9})
    with pytest.raises(ValueError, match="alloy: no attenuation is tabulated of Xy; there is C, Al, Ti"):
        material("alloy", 4.4, {"Ti": 0.9, "Xy": 0.1})
    with pytest.raises(ValueError, match="count 3: expected 4 to 12"):
        energy_bins(90.0, count=3)
