"""How strongly materials attenuate X-rays, and what energies a C-arm sends.

The spectrum is cut into six bins around the energies of the table below; each material is six linear attenuation
coefficients. That is enough for beam hardening to come out right to a few per cent: 10 mm of titanium attenuate less
per mm than 1 mm does. No K-edge of these materials lies in the range but caesium iodide's (33 and 36 keV), whose
lowest bin counts as below it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from screwpose._types import FloatArray

ENERGIES_KEV = np.array([30.0, 40.0, 50.0, 60.0, 80.0, 100.0])
_BIN_EDGES_KEV = np.array([20.0, 35.0, 45.0, 55.0, 70.0, 90.0, 125.0])


@dataclass(frozen=True, eq=False)
class Material:
    """A material by its linear attenuation at `ENERGIES_KEV`, (6,), per mm."""

    name: str
    attenuation_per_mm: FloatArray


# Total mass attenuation with coherent scattering, cm^2/g at ENERGIES_KEV: xraylib 4.3 (Schoonjans et al. 2011), which
# has the values of NIST (Hubbell & Seltzer, NISTIR 5632). Tissues are NIST's compounds of those names.
_MASS_ATTENUATION_CM2_PER_G: dict[str, tuple[float, ...]] = {
    "adipose": (0.3028, 0.2386, 0.2122, 0.1977, 0.1806, 0.1695),
    "muscle": (0.3794, 0.2689, 0.2263, 0.2048, 0.1822, 0.1692),
    "cortical bone": (1.2801, 0.6451, 0.4148, 0.3102, 0.2221, 0.1860),
    "Al": (1.1284, 0.5684, 0.3682, 0.2778, 0.2018, 0.1704),
    "Ti": (4.9719, 2.2126, 1.2135, 0.7660, 0.4053, 0.2721),
    "V": (5.5649, 2.4720, 1.3475, 0.8438, 0.4371, 0.2877),
    "Cr": (6.4346, 2.8554, 1.5512, 0.9640, 0.4905, 0.3166),
    "Fe": (8.1775, 3.6289, 1.9574, 1.2049, 0.5952, 0.3717),
    "Co": (8.9628, 3.9799, 2.1444, 1.3140, 0.6414, 0.3949),
    "Ni": (10.3449, 4.5996, 2.4746, 1.5111, 0.7306, 0.4439),
    "Mo": (28.1009, 12.9378, 7.0400, 4.2736, 1.9623, 1.0957),
    "CsI": (9.0466, 22.9696, 12.8723, 7.9212, 3.6771, 2.0354),
}


def material(name: str, density_g_per_cm3: float, mass_fractions: Mapping[str, float]) -> Material:
    """A mixture of the substances of the table by their mass fractions, which add up to 1."""
    total = sum(mass_fractions.values())
    if abs(total - 1.0) > 1e-9:
        raise ValueError(f"the mass fractions of {name} add up to {total:g}, expected 1")
    cm2_per_g = sum(f * np.array(_MASS_ATTENUATION_CM2_PER_G[part]) for part, f in mass_fractions.items())
    return Material(name, np.asarray(cm2_per_g * density_g_per_cm3 / 10.0))


# Densities: NIST's for the tissues, the ICRU's (report 46) 1.18 for spongiosa, handbooks' for the metals.
FAT = material("fat", 0.92, {"adipose": 1.0})
MUSCLE = material("muscle", 1.04, {"muscle": 1.0})
# The belly in front of the spine, organs and fat together.
VISCERA = material("viscera", 1.0, {"muscle": 0.7, "adipose": 0.3})
DISC = material("disc", 1.1, {"muscle": 1.0})
CORTICAL_BONE = material("cortical bone", 1.85, {"cortical bone": 1.0})
CANCELLOUS_BONE = material("cancellous bone", 1.18, {"cortical bone": 0.3, "muscle": 0.4, "adipose": 0.3})
GAS = Material("gas", np.zeros(len(ENERGIES_KEV)))  # 0.0012 g/cm^3: 10 cm of it take away a tenth of a per cent
TITANIUM = material("titanium", 4.43, {"Ti": 0.90, "Al": 0.06, "V": 0.04})  # Ti-6Al-4V, ASTM F136
COBALT_CHROME = material("cobalt-chrome", 8.3, {"Co": 0.66, "Cr": 0.28, "Mo": 0.06})  # ASTM F1537
STEEL = material("steel", 8.0, {"Fe": 0.655, "Cr": 0.175, "Ni": 0.14, "Mo": 0.03})  # 316L, ASTM F138
MATERIALS = {
    item.name: item
    for item in (
        FAT, MUSCLE, VISCERA, DISC, CORTICAL_BONE, CANCELLOUS_BONE, GAS, TITANIUM, COBALT_CHROME, STEEL,
    )
}  # fmt: skip


@cache
def _spectrum(peak_kv: float, filter_mm_al: float, scintillator_mm: float) -> tuple[float, ...]:
    energy = np.arange(_BIN_EDGES_KEV[0] + 0.5, _BIN_EDGES_KEV[-1], 1.0)
    log_al = np.log(np.array(_MASS_ATTENUATION_CM2_PER_G["Al"]))
    al_per_mm = 0.27 * np.exp(np.interp(np.log(energy), np.log(ENERGIES_KEV), log_al))
    photons = np.maximum(peak_kv / energy - 1.0, 0.0) * np.exp(-al_per_mm * filter_mm_al)
    csi_per_mm = 0.451 * np.array(_MASS_ATTENUATION_CM2_PER_G["CsI"])
    absorbed = 1.0 - np.exp(-csi_per_mm * scintillator_mm)
    signal, _ = np.histogram(energy, _BIN_EDGES_KEV, weights=photons * energy)
    return tuple(signal * absorbed / float((signal * absorbed).sum()))


def detector_spectrum(peak_kv: float, filter_mm_al: float = 9.0, scintillator_mm: float = 0.4) -> FloatArray:
    """What share of the detector's signal each energy bin makes where nothing is in the way.

    Kramers' law (photons ~ kVp/E - 1), filtered, weighted by the energy that a caesium iodide screen absorbs. No
    characteristic lines (tungsten's at 58 to 69 keV carry some 5 per cent at 90 kV), no escape of fluorescence.

    Parameters
    ----------
    peak_kv : tube voltage, 50 to 125 kV.
    filter_mm_al : total filtration as mm of aluminium; a C-arm's 0.2 mm of copper count as some 6.
    scintillator_mm : thickness of solid caesium iodide.

    Returns
    -------
    (6,), adding up to 1.
    """
    if not 50.0 <= peak_kv <= 125.0:
        raise ValueError(f"peak_kv {peak_kv:g}: expected 50 to 125 kV")
    return np.array(_spectrum(float(peak_kv), float(filter_mm_al), float(scintillator_mm)))
