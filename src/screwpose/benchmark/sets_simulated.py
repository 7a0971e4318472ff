"""The simulated sets: what each of them varies, and what it leaves as it should be.

What a case of a set is, follows from its recipe, the set's name, the seed and the index. A change of a recipe, or of
the simulator, that moves a screw, a camera or a mark makes another set of it: give it a new version.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from screwpose.benchmark.sets_base import BenchmarkSet, case_seed
from screwpose.simulation.imperfections import Imperfections
from screwpose.simulation.scenes_options import SceneOptions

if TYPE_CHECKING:
    from screwpose.simulation.scenes import ScenePlan

Recipe = Callable[[np.random.Generator], tuple[SceneOptions, Imperfections]]
"""What one case of a set is drawn from; the generator is for what differs from case to case."""


class _Screws(TypedDict):
    lengths_mm: tuple[float, float]
    diameters_mm: tuple[float, float]


_ANY_SCREW = _Screws(lengths_mm=(30.0, 60.0), diameters_mm=(4.5, 8.5))


def _noise(rng: np.random.Generator) -> Imperfections:
    return Imperfections(landmark_noise_px=round(float(rng.uniform(0.5, 3.0)), 3))


def _paper(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    return SceneOptions(needles=True), Imperfections(landmark_noise_px=1.5)


def _pairs(rng: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    options = SceneOptions(
        **_ANY_SCREW,
        designs=(1, 2),
        polyaxial=0.3,
        tower=0.85,
        tower_length_mm=(70.0, 120.0),
        convergence_deg=(5.0, 30.0),
        angle_deg=(60.0, 120.0),
        overlap_lat=(0.0, 1.0),
        models_named="AP",
    )
    return options, _noise(rng)


def _noisy(rng: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    return _pairs(rng)[0], Imperfections(landmark_noise_px=4.0)


def _hard(rng: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    options = SceneOptions(
        **_ANY_SCREW,
        levels=(1, 1),
        polyaxial=0.3,
        tower_length_mm=(70.0, 120.0),
        convergence_deg=(5.0, 30.0),
        angle_deg=(60.0, 120.0),
        overlap_lat=(0.0, 1.0),
        max_epipolar_gap_px=2.0,
    )
    return options, _noise(rng)


def _multi(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    options = SceneOptions(
        **_ANY_SCREW,
        screws=(3, 12),
        levels=(2, 6),
        designs=(1, 3),
        polyaxial=0.3,
        tower=0.85,
        tower_length_mm=(70.0, 120.0),
        convergence_deg=(5.0, 30.0),
        angle_deg=(75.0, 105.0),
        overlap_lat=(0.0, 1.0),
        missing=(0, 2),
        shift_mm=(0.0, 90.0),
        models_named="AP",
    )
    return options, Imperfections(landmark_noise_px=1.5)


def _tilted(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    options = SceneOptions(
        **_ANY_SCREW, polyaxial=1.0, tower_tilt_deg=(3.0, 20.0), angle_deg=(75.0, 105.0), overlap_lat=(0.0, 1.0)
    )
    return options, Imperfections(landmark_noise_px=1.5)


def _clutter(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    options = SceneOptions(**_ANY_SCREW, clutter=(3, 8), angle_deg=(75.0, 105.0), overlap_lat=(0.0, 1.0))
    return options, Imperfections(landmark_noise_px=1.5)


def _geometry(rng: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    # From what a good calibration leaves to what no calibration does, evenly in the logarithm.
    amount = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
    options = SceneOptions(**_ANY_SCREW, angle_deg=(75.0, 105.0), overlap_lat=(0.0, 1.0))
    return options, Imperfections(
        landmark_noise_px=1.5,
        focal_error_percent=round(2.0 * amount, 4),
        principal_error_px=round(20.0 * amount, 4),
        rotation_error_deg=round(2.0 * amount, 4),
        translation_error_mm=round(6.0 * amount, 4),
    )


def _clean(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    return SceneOptions(angle_deg=(80.0, 100.0), overlap_lat=(0.0, 1.0)), Imperfections(landmark_noise_px=1.0)


def _smoke(_: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
    return SceneOptions(image_size=(512, 512)), Imperfections(landmark_noise_px=0.75)


@dataclass(frozen=True)
class SimulatedSet:
    """How the cases of a simulated set are made."""

    name: str
    version: int
    size: int
    recipe: Recipe
    description: str

    def plan(self, seed: int, index: int) -> "ScenePlan":
        """What a case is, without X-raying it."""
        from screwpose.simulation.scenes import plan_scene

        own = case_seed(self.name, seed, index)
        options, imperfections = self.recipe(np.random.default_rng(own))
        return plan_scene(options, imperfections, own, case_id=f"{self.name}-{seed}-{index:04d}")

    def make(self, seed: int, index: int, folder: Path) -> Path:
        """Make a case in a folder; returns the path of its case.json."""
        from screwpose.simulation.scenes import xrayed
        from screwpose.simulation.writing import write_case

        asked = {"set": self.name, "set_version": self.version, "set_seed": seed, "index": index}
        return write_case(xrayed(self.plan(seed, index)), folder, asked)

    def as_set(self) -> BenchmarkSet:
        """As one of all sets."""
        return BenchmarkSet(self.name, self.version, self.make, self.size, "simulated", self.description)


_PLAIN = (
    SimulatedSet(
        "paper",
        2,
        5,
        _paper,
        "two screws with towers that overlap in LAT, views 84 to 96 degrees apart, marks with 1.5 px of noise; with "
        "X-rays of a needle along each tower",
    ),
    SimulatedSet(
        "pairs",
        1,
        1000,
        _pairs,
        "two screws, 30 to 60 mm long and 4.5 to 8.5 mm thick, with and without towers, views 60 to 120 degrees apart, "
        "any overlap, marks with 0.5 to 3 px of noise",
    ),
    SimulatedSet(
        "noisy",
        1,
        300,
        _noisy,
        "as `pairs`, but marks with 4 px of noise: careless clicks, or a poor detector",
    ),
    SimulatedSet(
        "hard",
        1,
        500,
        _hard,
        "two screws of one level whose labels can be swapped for less than 2 px of epipolar distance, marks with "
        "0.5 to 3 px of noise",
    ),
    SimulatedSet(
        "multi",
        1,
        300,
        _multi,
        "3 to 12 screws of up to three designs over 2 to 6 levels, up to two marks missing, marks with 1.5 px of noise",
    ),
    SimulatedSet(
        "tilted",
        1,
        300,
        _tilted,
        "two polyaxial screws whose towers lean by 3 to 20 degrees, marks with 1.5 px of noise",
    ),
    SimulatedSet(
        "clutter",
        1,
        300,
        _clutter,
        "two screws among 3 to 8 pieces of other metal, marks with 1.5 px of noise",
    ),
    SimulatedSet(
        "geometry",
        1,
        300,
        _geometry,
        "two screws, P wrong by 0.1 to 2 degrees, 0.3 to 6 mm, 0.1 to 2 % of the focal length and 1 to 20 px of the "
        "principal point, all by the same share, marks with 1.5 px of noise",
    ),
    SimulatedSet(
        "clean",
        1,
        100,
        _clean,
        "two screws with towers, nothing wrong, marks with 1 px of noise: the floor of the accuracy",
    ),
    SimulatedSet(
        "smoke",
        1,
        12,
        _smoke,
        "two screws with towers in images of 512 x 512, marks with 0.75 px of noise: small and quick, for every change",
    ),
)

_SPOILED = {
    "noisy": ("marks with 4 px of noise", {"landmark_noise_px": 4.0}),
    "biased": (
        "the centres marked 1 mm too near the head, which is 5 px where a screw is seen from the side",
        {"center_bias_mm": 1.0},
    ),
    "uncalibrated": (
        "P wrong by 2 % of the focal length, and by 1 degree between the views",
        {"focal_error_percent": 2.0, "rotation_error_deg": 1.0},
    ),
    "distorted": (
        "X-rays distorted by 2 px at half their side, of which P says nothing",
        {"pincushion": 2.0 / 512.0},
    ),
}


def _spoiled(base: SimulatedSet, dials: Mapping[str, float]) -> Recipe:
    def recipe(rng: np.random.Generator) -> tuple[SceneOptions, Imperfections]:
        options, imperfections = base.recipe(rng)
        return options, replace(imperfections, **dials)

    return recipe


# `noisy` is what would be `pairs-noisy`.
RECIPES = (
    *_PLAIN,
    *(
        SimulatedSet(f"{base.name}-{name}", 1, base.size, _spoiled(base, dials), f"as `{base.name}`, but {words}")
        for base in _PLAIN
        if base.name in ("pairs", "hard", "multi")
        for name, (words, dials) in _SPOILED.items()
        if (base.name, name) != ("pairs", "noisy")
    ),
)

SIMULATED = tuple(recipe.as_set() for recipe in RECIPES)
