"""What a C-arm's tube sends, and how much of it a screen turns into signal, energy by energy.

Everything comes from one table of 22 kB, made once by tools/make_xray_tables.py with spekpy (tungsten spectra) and
xraylib (attenuation); neither is needed here. Energies are bins of 1 keV from 10 to 125 keV, named by their middles.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from screwpose._types import FloatArray

Scintillator = Literal["CsI", "Gd2O2S"]

_DENSITY_G_PER_CM3 = {"CsI": 4.51, "Gd2O2S": 7.32, "Al": 2.70, "Cu": 8.96}


@dataclass(frozen=True, eq=False)
class XrayTables:
    """The shipped table.

    Parameters
    ----------
    energy_kev : (E,), the middles of bins of 1 keV.
    kv : (K,), tube voltages.
    bremsstrahlung, lines : (K, E), photons / (cm^2 mAs) in each bin at 1 m behind `inherent_mm_al` of aluminium.
    hvl_mm_al : (K,), the half-value layers that spekpy states for them.
    attenuation_cm2_per_g : (E,) for each substance, total with coherent scattering.
    absorption_cm2_per_g, fluorescence_cm2_per_g : (E,) for each scintillator: the energy it keeps if all K
        fluorescence leaves, and what that fluorescence takes.
    fluorescence_attenuation_cm2_per_g : of each scintillator for its own K fluorescence.
    provenance : versions, command, compositions.
    """

    energy_kev: FloatArray
    kv: FloatArray
    bremsstrahlung: FloatArray
    lines: FloatArray
    hvl_mm_al: FloatArray
    attenuation_cm2_per_g: Mapping[str, FloatArray]
    absorption_cm2_per_g: Mapping[str, FloatArray]
    fluorescence_cm2_per_g: Mapping[str, FloatArray]
    fluorescence_attenuation_cm2_per_g: Mapping[str, float]
    provenance: Mapping[str, Any]

    @property
    def inherent_mm_al(self) -> float:
        """The filtration that is in the spectra already."""
        return float(self.provenance["inherent_mm_al"])


@cache
def xray_tables() -> XrayTables:
    """The shipped table, read once."""
    path = files("screwpose.simulation") / "tables" / "xray.npz"
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        numbers = {
            name: archive[name].astype(np.float64)
            for name in archive.files
            if name not in ("materials", "scintillators", "provenance")
        }
        substances = archive["materials"].tolist()
        screens = archive["scintillators"].tolist()
        provenance = json.loads(str(archive["provenance"]))
    own = numbers["fluorescence_attenuation_cm2_per_g"].tolist()
    return XrayTables(
        energy_kev=numbers["energy_kev"],
        kv=numbers["kv"],
        bremsstrahlung=numbers["bremsstrahlung"],
        lines=numbers["lines"],
        hvl_mm_al=numbers["hvl_mm_al"],
        attenuation_cm2_per_g=dict(zip(substances, numbers["attenuation_cm2_per_g"], strict=True)),
        absorption_cm2_per_g=dict(zip(screens, numbers["absorption_cm2_per_g"], strict=True)),
        fluorescence_cm2_per_g=dict(zip(screens, numbers["fluorescence_cm2_per_g"], strict=True)),
        fluorescence_attenuation_cm2_per_g=dict(zip(screens, own, strict=True)),
        provenance=provenance,
    )


def tube_spectrum(peak_kv: float, filter_mm_al: float = 4.0, filter_mm_cu: float = 0.1) -> FloatArray:
    """Photons in each bin of 1 keV, per cm^2 and mAs at 1 m, in air.

    Between the tabulated voltages, 5 kV apart, the unfiltered bremsstrahlung is interpolated along E / kV, the
    characteristic lines where they are.

    Parameters
    ----------
    peak_kv : tube voltage, 50 to 125 kV.
    filter_mm_al, filter_mm_cu : total filtration. The tube itself is 1 mm of aluminium.

    Returns
    -------
    (E,).

    Raises
    ------
    ValueError
        The voltage or the filtration is out of range.
    """
    tables = xray_tables()
    low, high = tables.kv[0], tables.kv[-1]
    if not low <= peak_kv <= high:
        raise ValueError(f"peak_kv {peak_kv:g}: expected {low:g} to {high:g} kV")
    if filter_mm_al < tables.inherent_mm_al:
        raise ValueError(
            f"filter_mm_al {filter_mm_al:g}: expected at least {tables.inherent_mm_al:g}, which the tube itself has"
        )
    if filter_mm_cu < 0.0:
        raise ValueError(f"filter_mm_cu {filter_mm_cu:g}: expected 0 or more")
    energy = tables.energy_kev
    al_per_mm, cu_per_mm = (linear_per_mm(name) for name in ("Al", "Cu"))
    inherent = np.exp(-al_per_mm * tables.inherent_mm_al)
    above = int(np.clip(np.searchsorted(tables.kv, peak_kv), 1, len(tables.kv) - 1))
    share_above = (peak_kv - tables.kv[above - 1]) / (tables.kv[above] - tables.kv[above - 1])
    photons = np.zeros(len(energy))
    for index, share in ((above - 1, 1.0 - share_above), (above, share_above)):
        scale = tables.kv[index] / peak_kv
        unfiltered = tables.bremsstrahlung[index] / inherent
        stretched = np.interp(energy * scale, energy, unfiltered, right=0.0) * scale
        photons += share * (stretched * inherent + tables.lines[index])
    # The last bin that the voltage cuts holds only the part of it below.
    photons *= np.clip(peak_kv - (energy - 0.5), 0.0, 1.0)
    added_mm_al = filter_mm_al - tables.inherent_mm_al
    return np.asarray(photons * np.exp(-al_per_mm * added_mm_al - cu_per_mm * filter_mm_cu))


def absorbed_kev(scintillator: Scintillator, scintillator_mm: float) -> FloatArray:
    """Energy that a screen keeps of a photon that meets it, the mean over many, in each bin.

    K fluorescence is emitted in all directions from where the photon was absorbed, and escapes through either face
    unless it is absorbed on its way; it is 23 to 35 keV of those that have caused it in caesium iodide, 42 to 50 in
    gadolinium oxysulfide.

    Parameters
    ----------
    scintillator_mm : thickness if the screen were solid. The columns of caesium iodide fill three quarters of a layer.

    Returns
    -------
    (E,), keV.

    References
    ----------
    Chan & Doi (1983), Phys. Med. Biol. 28, 565, on the reabsorption of K fluorescence.
    """
    tables = xray_tables()
    if scintillator not in tables.absorption_cm2_per_g:
        raise ValueError(f"scintillator {scintillator!r}: expected one of {', '.join(tables.absorption_cm2_per_g)}")
    if scintillator_mm <= 0.0:
        raise ValueError(f"scintillator_mm {scintillator_mm:g}: expected more than 0")
    per_mm = linear_per_mm(scintillator)
    to_per_mm = _DENSITY_G_PER_CM3[scintillator] / 10.0
    own_per_mm = tables.fluorescence_attenuation_cm2_per_g[scintillator] * to_per_mm
    depth_mm = (np.arange(64) + 0.5) / 64 * scintillator_mm
    nodes, weights = np.polynomial.legendre.leggauss(32)
    cosine, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    escapes = np.zeros(len(depth_mm))
    for way_mm in (depth_mm, scintillator_mm - depth_mm):
        escapes += 0.5 * np.exp(-own_per_mm * way_mm[:, None] / cosine) @ weights
    # Where along its way through the screen a photon of each energy is stopped.
    stopped = np.exp(-per_mm[:, None] * depth_mm)
    escaping = (stopped @ escapes) / stopped.sum(axis=1)
    kept = tables.absorption_cm2_per_g[scintillator] + tables.fluorescence_cm2_per_g[scintillator] * (1.0 - escaping)
    share = -np.expm1(-per_mm * scintillator_mm) * kept * to_per_mm / per_mm
    return np.asarray(tables.energy_kev * share)


def signal_spectrum(
    peak_kv: float,
    filter_mm_al: float = 4.0,
    filter_mm_cu: float = 0.1,
    scintillator: Scintillator = "CsI",
    scintillator_mm: float = 0.4,
) -> FloatArray:
    """What share of the detector's signal each bin of 1 keV makes where nothing is in the way; (E,), adding up to 1."""
    signal = tube_spectrum(peak_kv, filter_mm_al, filter_mm_cu) * absorbed_kev(scintillator, scintillator_mm)
    return np.asarray(signal / signal.sum())


def half_value_layer_mm_al(photons: FloatArray) -> float:
    """Aluminium that halves the air kerma of a spectrum; photons (E,) in the table's bins."""
    kerma = photons * _air_kerma_per_photon()
    per_mm = linear_per_mm("Al")
    low, high = 0.0, 50.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if (kerma * np.exp(-per_mm * middle)).sum() > 0.5 * kerma.sum():
            low = middle
        else:
            high = middle
    return low


def linear_per_mm(substance: str) -> FloatArray:
    """Linear attenuation (E,) of a filter or scintillator at its solid density."""
    mass = xray_tables().attenuation_cm2_per_g[substance]
    return np.asarray(mass * _DENSITY_G_PER_CM3[substance] / 10.0)


def _air_kerma_per_photon() -> FloatArray:
    """E times the mass energy absorption of dry air, up to a factor: NIST's table 4 (NISTIR 5632), in log-log."""
    kev = np.array([10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0])
    absorption = np.array([4.742, 1.334, 0.5389, 0.1537, 0.06833, 0.04098, 0.03041, 0.02407, 0.02325, 0.02496])
    energy = xray_tables().energy_kev
    return np.asarray(energy * np.exp(np.interp(np.log(energy), np.log(kev), np.log(absorption))))
