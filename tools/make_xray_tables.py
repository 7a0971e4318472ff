# /// script
# requires-python = ">=3.11"
# dependencies = ["spekpy>=2.5", "xraylib>=4.1", "numpy>=2.1"]
# ///
"""Make the table of tube spectra and attenuation that the simulator ships with.

    uv run tools/make_xray_tables.py src/screwpose/simulation/tables/xray.npz

Needs spekpy (Poludniowski et al. 2021, Med. Phys. 48, 3630) and xraylib (Schoonjans et al. 2011, Spectrochim. Acta B
66, 776); the simulator needs neither. All is on bins of 1 keV, [10, 11] to [124, 125], named by their middles. A
coefficient is the mean over 20 energies in its bin, so that a bin with an absorption edge in it has its share of both
sides.

In the file, all float32 but the provenance:

- energy_kev (E,), kv (K,)
- bremsstrahlung, lines (K, E): photons / (cm^2 mAs) in each bin at 1 m, behind the inherent filtration
- hvl_mm_al (K,): the half-value layer of each spectrum, as spekpy states it
- attenuation_cm2_per_g (M, E): total, with coherent scattering, of `materials` (M,)
- absorption_cm2_per_g, fluorescence_cm2_per_g (2, E) of `scintillators`: energy absorption if all K fluorescence
  left, and what more it is if it stayed
- fluorescence_attenuation_cm2_per_g (2,): of the scintillator for its own K fluorescence
- provenance: JSON
"""

import argparse
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import spekpy
import xraylib

LOWEST_KEV, HIGHEST_KEV = 10, 125
KV = np.arange(50, 126, 5)
ANODE_DEG = 11.0
INHERENT_MM_AL = 1.0
PER_BIN = 20

# By mass. Elements, then compounds; tissues as in ICRU report 44 (NIST's table 2) and, for spongiosa, skin and
# cartilage, report 46.
ELEMENTS = ("C", "Al", "Ti", "V", "Cr", "Mn", "Fe", "Co", "Ni", "Cu", "Mo", "Pb", "W")
COMPOUNDS: dict[str, dict[str, float]] = {
    "water": {"H": 0.111894, "O": 0.888106},
    "air": {"C": 0.000124, "N": 0.755268, "O": 0.231781, "Ar": 0.012827},
    "adipose": {"H": 0.114, "C": 0.598, "N": 0.007, "O": 0.278, "Na": 0.001, "S": 0.001, "Cl": 0.001},
    "muscle": {
        "H": 0.102, "C": 0.143, "N": 0.034, "O": 0.710, "Na": 0.001, "P": 0.002, "S": 0.003, "Cl": 0.001, "K": 0.004,
    },
    "soft tissue": {
        "H": 0.102, "C": 0.143, "N": 0.034, "O": 0.708, "Na": 0.002, "P": 0.003, "S": 0.003, "Cl": 0.002, "K": 0.003,
    },
    "blood": {
        "H": 0.102, "C": 0.110, "N": 0.033, "O": 0.745, "Na": 0.001, "P": 0.001, "S": 0.002, "Cl": 0.003, "K": 0.002,
        "Fe": 0.001,
    },
    "lung": {
        "H": 0.103, "C": 0.105, "N": 0.031, "O": 0.749, "Na": 0.002, "P": 0.002, "S": 0.003, "Cl": 0.003, "K": 0.002,
    },
    "cortical bone": {
        "H": 0.034, "C": 0.155, "N": 0.042, "O": 0.435, "Na": 0.001, "Mg": 0.002, "P": 0.103, "S": 0.003, "Ca": 0.225,
    },
    "spongiosa": {
        "H": 0.085, "C": 0.404, "N": 0.028, "O": 0.367, "Na": 0.001, "Mg": 0.001, "P": 0.034, "S": 0.002, "Cl": 0.002,
        "K": 0.001, "Ca": 0.074, "Fe": 0.001,
    },
    "skin": {
        "H": 0.100, "C": 0.204, "N": 0.042, "O": 0.645, "Na": 0.002, "P": 0.001, "S": 0.002, "Cl": 0.003, "K": 0.001,
    },
    "cartilage": {
        "H": 0.096, "C": 0.099, "N": 0.022, "O": 0.744, "Na": 0.005, "P": 0.022, "S": 0.009, "Cl": 0.003,
    },
    "PEEK": {"C": 0.7915, "H": 0.0420, "O": 0.1665},  # C19 H12 O3
    # Seven tenths fibre, the rest epoxy of bisphenol A, cured with an amine.
    "carbon fibre": {"C": 0.7 + 0.3 * 0.72, "H": 0.3 * 0.08, "O": 0.3 * 0.16, "N": 0.3 * 0.04},
    "CsI": {"Cs": 0.511549, "I": 0.488451},
    "Gd2O2S": {"Gd": 0.830771, "O": 0.084527, "S": 0.084702},
}  # fmt: skip
SCINTILLATORS = ("CsI", "Gd2O2S")


def atomic_number(symbol: str) -> int:
    """Of an element."""
    return int(xraylib.SymbolToAtomicNumber(symbol))


def fine_energies() -> np.ndarray:
    """(E, PER_BIN), keV: the middles of equal parts of each bin."""
    starts = np.arange(LOWEST_KEV, HIGHEST_KEV)
    return starts[:, None] + (np.arange(PER_BIN) + 0.5) / PER_BIN


def mean_over_bins(of_element: Callable[[int, float], float], fractions: dict[str, float]) -> np.ndarray:
    """(E,): a coefficient of a mixture, by that of the elements (Z, keV)."""
    assert abs(sum(fractions.values()) - 1.0) < 2e-3, fractions
    total = sum(fractions.values())
    fine = fine_energies()
    values = np.zeros(fine.shape)
    for symbol, fraction in fractions.items():
        z = atomic_number(symbol)
        values += fraction / total * np.vectorize(lambda kev, z=z: of_element(z, float(kev)))(fine)
    return values.mean(axis=1)


_K_LINES = ("KL3", "KL2", "KM3", "KM2", "KN3", "KN2")


def k_fluorescence(z: int) -> list[tuple[float, float]]:
    """(keV, share of the vacancies in the K shell) of the lines of an element."""
    lines = []
    for name in _K_LINES:
        line = getattr(xraylib, f"{name}_LINE")
        try:
            energy, share = xraylib.LineEnergy(z, line), xraylib.RadRate(z, line)
        except ValueError:  # the element has no such line
            continue
        lines.append((energy, share))
    rate = sum(share for _, share in lines)
    yield_k = xraylib.FluorYield(z, xraylib.K_SHELL)
    return [(energy, yield_k * share / rate) for energy, share in lines]


def fluorescence(z: int, kev: float) -> float:
    """cm^2/g: photoelectric absorption in the K shell, times the share of the energy that K lines take away."""
    if z < 40 or kev <= xraylib.EdgeEnergy(z, xraylib.K_SHELL):
        return 0.0
    taken = sum(energy * share for energy, share in k_fluorescence(z))
    return float(xraylib.CS_Photo_Partial(z, xraylib.K_SHELL, kev) * taken / kev)


def attenuation_of_own_lines(fractions: dict[str, float]) -> float:
    """cm^2/g: of a scintillator for its own K fluorescence, the mean over its lines by their energy."""
    total = weight = 0.0
    for symbol, fraction in fractions.items():
        z = atomic_number(symbol)
        if z < 40:
            continue
        for energy, share in k_fluorescence(z):
            of_line = sum(f * xraylib.CS_Total(atomic_number(s), energy) for s, f in fractions.items())
            total += fraction * share * energy * of_line
            weight += fraction * share * energy
    return total / weight


def spectra() -> dict[str, np.ndarray]:
    """Tungsten tube at 1 m, by spekpy's model kqp, behind the inherent filtration."""
    middles = np.arange(LOWEST_KEV, HIGHEST_KEV) + 0.5
    parts: dict[str, list[np.ndarray]] = {"bremsstrahlung": [], "lines": []}
    hvl = []
    for kv in KV:
        for part, wanted in (("bremsstrahlung", "char"), ("lines", "brem")):
            tube = spekpy.Spek(kvp=float(kv), th=ANODE_DEG, dk=1.0, targ="W", physics="kqp", z=100.0, **{wanted: False})
            tube.filter("Al", INHERENT_MM_AL)
            energy, photons = tube.get_spectrum(diff=False)
            on_grid = np.zeros(len(middles))
            inside = (energy > LOWEST_KEV) & (energy < HIGHEST_KEV)
            index = np.round(energy[inside] - middles[0]).astype(int)
            assert np.abs(middles[index] - energy[inside]).max() < 1e-6
            on_grid[index] = photons[inside]
            parts[part].append(on_grid)
        both = spekpy.Spek(kvp=float(kv), th=ANODE_DEG, dk=0.5, targ="W", physics="kqp", z=100.0)
        hvl.append(both.filter("Al", INHERENT_MM_AL).get_hvl1())
    return {name: np.array(rows) for name, rows in parts.items()} | {"hvl_mm_al": np.array(hvl)}


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """As numpy does, but the same bytes each time: no times of day."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, values, allow_pickle=False)
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy", (2026, 1, 1, 0, 0, 0)), content.getvalue(), zipfile.ZIP_DEFLATED
            )


def tables() -> dict[str, np.ndarray]:
    """All arrays of the file."""
    names = [*ELEMENTS, *COMPOUNDS]
    fractions = [COMPOUNDS.get(name, {name: 1.0}) for name in names]
    result = {"energy_kev": np.arange(LOWEST_KEV, HIGHEST_KEV) + 0.5, "kv": KV.astype(float)} | spectra()
    result["attenuation_cm2_per_g"] = np.array([mean_over_bins(xraylib.CS_Total, f) for f in fractions])
    screens = [COMPOUNDS[name] for name in SCINTILLATORS]
    result["absorption_cm2_per_g"] = np.array([mean_over_bins(xraylib.CS_Energy, f) for f in screens])
    result["fluorescence_cm2_per_g"] = np.array([mean_over_bins(fluorescence, f) for f in screens])
    result["fluorescence_attenuation_cm2_per_g"] = np.array([attenuation_of_own_lines(f) for f in screens])
    result = {name: values.astype(np.float32) for name, values in result.items()}
    result["materials"] = np.array(names)
    result["scintillators"] = np.array(SCINTILLATORS)
    provenance = {
        "command": "uv run tools/make_xray_tables.py src/screwpose/simulation/tables/xray.npz",
        "spekpy": spekpy.__version__,
        "xraylib": xraylib.__version__,
        "numpy": np.__version__,
        "spectra": f"tungsten, anode {ANODE_DEG:g} deg, kqp, {INHERENT_MM_AL:g} mm Al, photons/(cm^2 mAs) at 1 m",
        "attenuation": f"xraylib CS_Total, mean over {PER_BIN} energies in each bin of 1 keV",
        "inherent_mm_al": INHERENT_MM_AL,
        "anode_deg": ANODE_DEG,
        "mass_fractions": COMPOUNDS,
    }
    result["provenance"] = np.array(json.dumps(provenance))
    return result


def main() -> None:
    """Write the file."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("path", type=Path)
    write_npz(arguments.parse_args().path, tables())


if __name__ == "__main__":
    main()
