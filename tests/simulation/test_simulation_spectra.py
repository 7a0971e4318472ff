"""Spectra and the table of attenuation, against values published by NIST, the IEC and spekpy."""

import importlib.util
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from screwpose._types import FloatArray
from screwpose.simulation import spectra
from screwpose.simulation.materials import MUSCLE, TITANIUM
from screwpose.simulation.spectra import (
    absorbed_kev,
    half_value_layer_mm_al,
    signal_spectrum,
    tube_spectrum,
    xray_tables,
)

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "src/screwpose/simulation/tables/xray.npz"

# cm^2/g at 30, 60, 100 keV, typed by hand from NIST's tables 3 and 4 (Hubbell & Seltzer, NISTIR 5632).
NIST = {
    "water": (0.3756, 0.2059, 0.1707),
    "muscle": (0.3783, 0.2048, 0.1693),
    "adipose": (0.3063, 0.1974, 0.1688),
    "cortical bone": (1.331, 0.3148, 0.1855),
    "Al": (1.128, 0.2778, 0.1704),
    "Ti": (4.972, 0.7661, 0.2721),
    "Fe": (8.176, 1.205, 0.3717),
    "Cu": (10.92, 1.593, 0.4584),
}


def at(kev: float, values: FloatArray) -> float:
    """Between the table's bins, in log-log."""
    return float(np.exp(np.interp(np.log(kev), np.log(xray_tables().energy_kev), np.log(values))))


@pytest.mark.parametrize("name", NIST)
def test_attenuation_is_that_of_nist(name):
    got = [at(kev, xray_tables().attenuation_cm2_per_g[name]) for kev in (30.0, 60.0, 100.0)]
    np.testing.assert_allclose(got, NIST[name], rtol=4e-3)


@pytest.mark.parametrize(
    ("name", "edge_kev", "below", "above"),
    # NIST's table 4 at the K edges of iodine, caesium and gadolinium.
    [("CsI", 33.169, 6.923, 21.22), ("CsI", 35.985, 17.19, 30.27), ("Gd2O2S", 50.239, 3.234, 15.55)],
)
def test_edges_lie_where_they_are(name, edge_kev, below, above):
    """The bin with the edge in it has its share of both sides; its neighbours are wholly on one."""
    energy, values = xray_tables().energy_kev, xray_tables().attenuation_cm2_per_g[name]
    inside = int(np.flatnonzero(np.abs(energy - edge_kev) < 0.5)[0])
    # Photoelectric absorption falls with about E^-2.7.
    at_edge = values * (energy / edge_kev) ** 2.7
    assert at_edge[inside - 1] == pytest.approx(below, rel=0.02)
    assert at_edge[inside + 1] == pytest.approx(above, rel=0.02)
    share_below = edge_kev - (energy[inside] - 0.5)
    assert at_edge[inside] == pytest.approx(share_below * below + (1.0 - share_below) * above, rel=0.02)


@pytest.mark.parametrize(("kev", "nist"), [(30.0, 8.071), (50.0, 6.596), (60.0, 4.586), (80.0, 2.399), (100.0, 1.391)])
def test_energy_absorption_of_caesium_iodide_is_that_of_nist(kev, nist):
    assert at(kev, xray_tables().absorption_cm2_per_g["CsI"]) == pytest.approx(nist, rel=0.02)


def test_half_value_layers_are_those_that_spekpy_states():
    tables = xray_tables()
    got = [half_value_layer_mm_al(tube_spectrum(kv, tables.inherent_mm_al, 0.0)) for kv in tables.kv]
    np.testing.assert_allclose(got, tables.hvl_mm_al, rtol=0.01)


@pytest.mark.parametrize(
    ("kv", "total_mm_al", "hvl_mm_al"),
    # Standard radiation qualities of IEC 61267: RQR 5, 6 and 8, whose filters a laboratory adjusts about 3 mm of
    # aluminium, and RQA 5, 7 and 9, which add 21, 30 and 40 mm.
    [(70, 2.9, 2.58), (80, 2.9, 3.01), (100, 3.2, 3.97), (70, 23.9, 6.8), (90, 33.0, 9.2), (120, 43.3, 11.6)],
)
def test_half_value_layers_are_those_of_standard_beams(kv, total_mm_al, hvl_mm_al):
    assert half_value_layer_mm_al(tube_spectrum(kv, total_mm_al, 0.0)) == pytest.approx(hvl_mm_al, rel=0.04)


def test_photons_per_kerma_are_those_of_a_standard_beam():
    """IEC 62220-1: RQA 5 has 30174 photons per mm^2 and uGy."""
    photons = tube_spectrum(70.0, 24.0, 0.0)
    energy = xray_tables().energy_kev
    # Mass energy absorption of air at 30, 40, 50, 60, 80 keV, NIST's table 4.
    kev, en = np.array([30.0, 40.0, 50.0, 60.0, 80.0]), np.array([0.1537, 0.06833, 0.04098, 0.03041, 0.02407])
    absorption = np.exp(np.interp(np.log(energy), np.log(kev), np.log(en)))
    joule_per_kev, g_per_kg, cm2_per_mm2 = 1.602177e-16, 1000.0, 0.01
    kerma_ugy = (photons * energy * absorption).sum() * joule_per_kev * g_per_kg * 1e6 / 1.0
    assert photons.sum() * cm2_per_mm2 / kerma_ugy == pytest.approx(30174.0, rel=0.03)


def test_tungsten_lines_stand_out_above_their_edge_only():
    """K alpha at 58.0 and 59.3, K beta at 67 to 69 keV, where the voltage is above tungsten's 69.5."""
    energy = xray_tables().energy_kev
    for kv, has_lines in ((65.0, False), (110.0, True)):
        photons = tube_spectrum(kv)
        around = 0.5 * (photons[energy == 56.5][0] + photons[energy == 61.5][0])
        assert bool(photons[energy == 59.5][0] > 1.5 * around) == has_lines
        assert bool(photons[energy == 57.5][0] > photons[energy == 56.5][0]) == has_lines
    assert not tube_spectrum(72.3)[energy > 73.0].any()
    assert not tube_spectrum(66.5)[energy > 67.0].any()  # no K beta, though 70 kV has one


def test_a_voltage_between_is_interpolated(monkeypatch):
    """With every other voltage left out of the table, what it had is found again."""
    full = xray_tables()
    thinned = replace(full, kv=full.kv[::2], bremsstrahlung=full.bremsstrahlung[::2], lines=full.lines[::2])
    expected = {kv: tube_spectrum(kv) for kv in (55.0, 85.0, 115.0)}
    monkeypatch.setattr(spectra, "xray_tables", lambda: thinned)
    for kv, want in expected.items():
        got = tube_spectrum(kv)
        assert np.abs(got - want).max() > 0.0
        for length_mm in (0.0, 100.0, 250.0):
            through = np.exp(-MUSCLE.linear_per_mm * length_mm - TITANIUM.linear_per_mm * length_mm / 50.0)
            assert (got * full.energy_kev) @ through == pytest.approx((want * full.energy_kev) @ through, rel=0.01)


def test_filters_attenuate():
    """0.1 mm of copper by hand at 60 keV: exp(-1.593 x 8.96 x 0.01) = 0.867."""
    energy = xray_tables().energy_kev
    ratio = tube_spectrum(90.0, 4.0, 0.1) / np.maximum(tube_spectrum(90.0, 4.0, 0.0), 1e-300)
    assert at(60.0, np.maximum(ratio, 1e-30)) == pytest.approx(0.867, abs=1e-3)
    assert ratio[energy == 20.5][0] < 0.1


def test_thin_screens_absorb_little_and_k_fluorescence_escapes():
    energy = xray_tables().energy_kev
    share = absorbed_kev("CsI", 0.4) / energy
    # Below the edges nothing is lost but what is scattered: 1 - exp(-8.66 x 0.451 x 0.4) = 0.79 at 30.5 keV, nearly all
    # of which stays.
    assert 0.65 < share[energy == 30.5][0] < 0.79
    # Just above caesium's edge most of the energy may leave again as K fluorescence.
    assert share[energy == 36.5][0] < 0.9 * -np.expm1(-29.17 * 0.451 * 0.4)
    thick = absorbed_kev("CsI", 20.0) / energy
    assert np.all(share[10:] < thick[10:])
    assert thick[energy == 70.5][0] > 0.9


def test_escape_of_fluorescence_agrees_with_counted_photons():
    """An independent way: photons drawn one by one, stopped by depth, fluorescing in all directions."""
    rng = np.random.default_rng(5)
    screen_mm, kev = 0.3, 60.5
    tables = xray_tables()
    index = int(np.flatnonzero(tables.energy_kev == kev)[0])
    per_mm = tables.attenuation_cm2_per_g["CsI"][index] * 0.451
    own_per_mm = tables.fluorescence_attenuation_cm2_per_g["CsI"] * 0.451
    depth = -np.log1p(-rng.random(400_000)) / per_mm
    depth = depth[depth < screen_mm]
    stopped = len(depth) / 400_000
    cosine = rng.uniform(-1.0, 1.0, len(depth))
    way = np.where(cosine > 0.0, screen_mm - depth, depth) / np.abs(cosine)
    stays = -np.log1p(-rng.random(len(depth))) / own_per_mm < way
    kept = tables.absorption_cm2_per_g["CsI"][index] + tables.fluorescence_cm2_per_g["CsI"][index] * stays.mean()
    want = kev * stopped * kept / tables.attenuation_cm2_per_g["CsI"][index]
    assert absorbed_kev("CsI", screen_mm)[index] == pytest.approx(want, rel=0.01)
    assert 0.2 < 1.0 - stays.mean() < 0.6


def test_spectrum_hardens_with_voltage_and_filter():
    energy = xray_tables().energy_kev
    means = [float(signal_spectrum(kv) @ energy) for kv in (60.0, 80.0, 100.0, 120.0)]
    assert np.all(np.diff(means) > 2.0)
    assert 38.0 < means[0] < means[-1] < 70.0
    assert signal_spectrum(90.0, 4.0, 0.3) @ energy > signal_spectrum(90.0) @ energy + 2.0
    assert signal_spectrum(90.0).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: tube_spectrum(20.0), "peak_kv 20: expected 50 to 125 kV"),
        (lambda: tube_spectrum(90.0, 0.5), "filter_mm_al 0.5: expected at least 1, which the tube itself has"),
        (lambda: tube_spectrum(90.0, 4.0, -0.1), "filter_mm_cu -0.1: expected 0 or more"),
        (lambda: absorbed_kev("NaI", 0.4), "scintillator 'NaI': expected one of CsI, Gd2O2S"),
        (lambda: absorbed_kev("CsI", 0.0), "scintillator_mm 0: expected more than 0"),
    ],
)
def test_bad_values_are_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_the_table_is_small_and_says_where_it_is_from():
    assert TABLE.stat().st_size < 100_000
    provenance = xray_tables().provenance
    assert provenance["command"].endswith("src/screwpose/simulation/tables/xray.npz")
    assert provenance["spekpy"] >= "2.5"
    assert provenance["xraylib"] >= "4.1"
    for fractions in provenance["mass_fractions"].values():
        assert sum(fractions.values()) == pytest.approx(1.0, abs=2e-3)


def test_the_wheel_contains_the_table(tmp_path):
    pytest.importorskip("hatchling", reason="the wheel is built with hatchling")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert archive.read("screwpose/simulation/tables/xray.npz") == TABLE.read_bytes()


def table_maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_xray_tables", ROOT / "tools/make_xray_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_can_be_made_again():
    """Where the libraries are: `uv run --with spekpy --with xraylib pytest ...`."""
    pytest.importorskip("spekpy", reason="spekpy makes the table; run time does without")
    pytest.importorskip("xraylib", reason="xraylib makes the table; run time does without")
    made = table_maker().tables()
    with np.load(TABLE) as shipped:
        for name in ("bremsstrahlung", "lines", "attenuation_cm2_per_g", "absorption_cm2_per_g"):
            np.testing.assert_allclose(made[name], shipped[name], rtol=1e-4, err_msg=name)
