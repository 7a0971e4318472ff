"""How strongly materials attenuate X-rays, and the few energies that stand for a C-arm's whole spectrum.

A material is its linear attenuation in bins of 1 keV. Summing over a hundred bins for each ray would be slow, so
`energy_bins` picks six of them, with weights such that the transmission is that of the full spectrum: to 0.3 % where
as much as a ten-thousandth comes through, for tissue up to 35 cm, titanium to 15 mm, cobalt-chrome or steel to 10 mm.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.simulation.spectra import Scintillator, signal_spectrum, xray_tables


@dataclass(frozen=True, eq=False)
class EnergyBins:
    """A spectrum reduced to a few energies.

    Parameters
    ----------
    weights : (B,), each energy's share of the signal where nothing is in the way, adding up to 1.
    index : (B,), which of the table's bins of 1 keV.
    """

    weights: FloatArray
    index: NDArray[np.int64]

    @property
    def energies_kev(self) -> FloatArray:
        """(B,), rising."""
        return xray_tables().energy_kev[self.index]


@dataclass(frozen=True, eq=False)
class Material:
    """A material by its linear attenuation, total with coherent scattering.

    Parameters
    ----------
    linear_per_mm : (E,), in the table's bins of 1 keV (`screwpose.simulation.spectra.xray_tables`).
    """

    name: str
    linear_per_mm: FloatArray

    def attenuation_per_mm_in(self, bins: EnergyBins) -> FloatArray:
        """(B,), per mm, at the energies of a reduced spectrum."""
        return self.linear_per_mm[bins.index]


def material(name: str, density_g_per_cm3: float, mass_fractions: Mapping[str, float]) -> Material:
    """A mixture of substances of the table by their mass fractions, which add up to 1."""
    total = sum(mass_fractions.values())
    if abs(total - 1.0) > 1e-9:
        raise ValueError(f"the mass fractions of {name} add up to {total:g}, expected 1")
    table = xray_tables().attenuation_cm2_per_g
    unknown = sorted(set(mass_fractions) - set(table))
    if unknown:
        raise ValueError(f"{name}: no attenuation is tabulated of {', '.join(unknown)}; there is {', '.join(table)}")
    cm2_per_g = sum(fraction * table[part] for part, fraction in mass_fractions.items())
    return Material(name, np.asarray(cm2_per_g * density_g_per_cm3 / 10.0))


# Tissues and their densities: ICRU report 44 (as in NIST's table 2), spongiosa, skin and cartilage report 46; lung as
# it is half inflated. Metals: handbooks'.
WATER = material("water", 1.0, {"water": 1.0})
FAT = material("fat", 0.95, {"adipose": 1.0})
SKIN = material("skin", 1.09, {"skin": 1.0})
MUSCLE = material("muscle", 1.05, {"muscle": 1.0})
SOFT_TISSUE = material("soft tissue", 1.06, {"soft tissue": 1.0})
BLOOD = material("blood", 1.06, {"blood": 1.0})
# The belly in front of the spine, organs and fat together.
VISCERA = material("viscera", 1.01, {"soft tissue": 0.7, "adipose": 0.3})
LUNG = material("lung", 0.26, {"lung": 1.0})
DISC = material("disc", 1.10, {"cartilage": 1.0})
CORTICAL_BONE = material("cortical bone", 1.92, {"cortical bone": 1.0})
CANCELLOUS_BONE = material("cancellous bone", 1.18, {"spongiosa": 1.0})
# 0.0012 g/cm^3: 10 cm of it take away a quarter of a per cent, and the open beam is full of it anyway.
GAS = Material("gas", np.zeros(len(xray_tables().energy_kev)))
TITANIUM = material("titanium", 4.43, {"Ti": 0.90, "Al": 0.06, "V": 0.04})  # Ti-6Al-4V, ASTM F136
COBALT_CHROME = material("cobalt-chrome", 8.3, {"Co": 0.66, "Cr": 0.28, "Mo": 0.06})  # ASTM F1537
STEEL = material("steel", 8.0, {"Fe": 0.635, "Cr": 0.175, "Ni": 0.14, "Mo": 0.03, "Mn": 0.02})  # 316L, ASTM F138
PEEK = material("PEEK", 1.30, {"PEEK": 1.0})
CARBON_FIBRE = material("carbon fibre", 1.55, {"carbon fibre": 1.0})  # table tops
ALUMINIUM = material("aluminium", 2.70, {"Al": 1.0})
COPPER = material("copper", 8.96, {"Cu": 1.0})
LEAD = material("lead", 11.35, {"Pb": 1.0})
MATERIALS = {
    item.name: item
    for item in (
        WATER, FAT, SKIN, MUSCLE, SOFT_TISSUE, BLOOD, VISCERA, LUNG, DISC, CORTICAL_BONE, CANCELLOUS_BONE, GAS,
        TITANIUM, COBALT_CHROME, STEEL, PEEK, CARBON_FIBRE, ALUMINIUM, COPPER, LEAD,
    )
}  # fmt: skip


def energy_bins(
    peak_kv: float,
    filter_mm_al: float = 4.0,
    filter_mm_cu: float = 0.1,
    scintillator: Scintillator = "CsI",
    scintillator_mm: float = 0.4,
    count: int = 6,
) -> EnergyBins:
    """The few energies, and their weights, that stand for a tube, its filters and a screen.

    Parameters
    ----------
    peak_kv : tube voltage, 50 to 125 kV.
    filter_mm_al, filter_mm_cu : total filtration; a C-arm has about 4 mm of aluminium and 0.1 mm of copper.
    scintillator_mm : thickness if the screen were solid.
    count : how many energies, 4 to 12. The largest error of the transmission (see the module) is 0.45 % with 5,
        0.3 % with 6, 0.1 % with 7.

    Raises
    ------
    ValueError
        A value is out of range.
    """
    if not 4 <= count <= 12:
        raise ValueError(f"count {count}: expected 4 to 12")
    arguments = float(peak_kv), float(filter_mm_al), float(filter_mm_cu), scintillator, float(scintillator_mm)
    return _energy_bins(*arguments, count)


@cache
def _energy_bins(
    peak_kv: float,
    filter_mm_al: float,
    filter_mm_cu: float,
    scintillator: Scintillator,
    scintillator_mm: float,
    count: int,
) -> EnergyBins:
    full = signal_spectrum(peak_kv, filter_mm_al, filter_mm_cu, scintillator, scintillator_mm)
    system = _transmissions_to_match(full)
    usable = np.flatnonzero(full > 1e-6 * full.max())
    # Neighbours are all but the same, so start from every fifth, and leave out one after the other. That is greedy: of
    # five different starts the best ends four times nearer than a single one.
    reduced = [_reduced(system, usable[start::5], full, count) for start in range(5)]
    index, weights, _ = min(reduced, key=lambda candidate: candidate[2])
    return EnergyBins(weights / weights.sum(), index)


def _reduced(
    system: tuple[FloatArray, FloatArray], index: NDArray[np.int64], full: FloatArray, count: int
) -> tuple[NDArray[np.int64], FloatArray, float]:
    """At most `count` energies, their weights, and the residual of the fit."""
    index, weights, _ = _fitted(system, index)
    while len(index) > count:
        fewer = [_fitted(system, np.delete(index, k)) for k in range(len(index))]
        index, weights, _ = min(fewer, key=lambda candidate: candidate[2])
    return _shifted_while_better(system, index, weights, full)


def _transmissions_to_match(full: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows of a linear system (N, E) for the weights and its right side (N,), by thicknesses that are met.

    Of all materials here, muscle and a metal span the rest: attenuation is photoelectric plus Compton, and no edge
    lies in the range.
    """
    tissue_mm = np.array([0.0, 20.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0])
    metals_mm = [(0.0, 0.0)]
    metals_mm += [(mm, 0.0) for mm in (0.5, 1.0, 2.0, 4.0, 7.0, 11.0, 15.0)]
    metals_mm += [(0.0, mm) for mm in (0.5, 1.0, 2.0, 3.5, 6.0, 10.0)]
    materials = np.stack([MUSCLE.linear_per_mm, TITANIUM.linear_per_mm, COBALT_CHROME.linear_per_mm])
    lengths = np.array([(tissue, *metals) for tissue in tissue_mm for metals in metals_mm])
    by_energy = np.exp(-lengths @ materials)
    expected = by_energy @ full
    # Relative errors, down to where scatter and noise bury everything.
    importance = 1.0 / (expected + 1e-5)
    open_beam = 30.0  # as good as exactly 1
    rows = np.vstack([by_energy * importance[:, None], np.full((1, len(full)), open_beam)])
    return rows, np.append(expected * importance, open_beam)


def _fitted(
    system: tuple[FloatArray, FloatArray], index: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray, float]:
    """The energies among `index` that take part, their weights, and the residual."""
    from scipy.optimize import nnls

    rows, right = system
    weights, residual = nnls(rows[:, index], right, maxiter=100 * len(index))
    used = weights > 0.0
    return index[used], np.asarray(weights[used]), float(residual)


def _shifted_while_better(
    system: tuple[FloatArray, FloatArray], index: NDArray[np.int64], weights: FloatArray, full: FloatArray
) -> tuple[NDArray[np.int64], FloatArray, float]:
    """Each energy moved by single keV as long as the fit gets better."""
    best = _fitted(system, index)[2]
    improved = True
    while improved:
        improved = False
        for k in range(len(index)):
            for step in (-1, 1):
                moved = index.copy()
                moved[k] += step
                if not 0 <= moved[k] < len(full) or full[moved[k]] == 0.0 or len(np.unique(moved)) < len(moved):
                    continue
                used, fitted, residual = _fitted(system, moved)
                if residual < 0.999 * best and len(used) == len(index):
                    index, weights, best, improved = used, fitted, residual, True
    return index, weights, best
