"""The named sets: frozen by version, each case by itself, and what they promise. Nothing large is rendered."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from screwpose.benchmark import SETS, get_set
from screwpose.benchmark.sets_other import other_folder, plan_other
from screwpose.benchmark.sets_simulated import RECIPES, SimulatedSet
from screwpose.errors import CaseError, InputError
from screwpose.files.case import read_case
from screwpose.files.truth import read_truth
from screwpose.geometry.epipolar import epipolar_distances_px
from screwpose.simulation import ScenePlan
from tests.data import shared_data

BY_NAME = {recipe.name: recipe for recipe in RECIPES}
SIZES = {
    "paper": 5,
    "pairs": 1000,
    "noisy": 300,
    "hard": 500,
    "multi": 300,
    "tilted": 300,
    "clutter": 300,
    "geometry": 300,
    "clean": 100,
    "smoke": 12,
    "real": 16,
    "other": 100,
}
SPOILED = {
    f"{base}-{what}": SIZES[base]
    for base in ("pairs", "hard", "multi")
    for what in ("noisy", "biased", "uncalibrated", "distorted")
    if f"{base}-{what}" != "pairs-noisy"  # which is `noisy`
}
# Cases 0 and 1 of seed 2026: what the truth, the cameras and the marks are, to 1e-6.
FROZEN = {
    ("paper", 2): "52c184c8bbe82ef8",
    ("pairs", 1): "be49931b81da5565",
    ("noisy", 1): "fb5a8c23eacae9e9",
    ("hard", 1): "edf01af6572e361f",
    ("multi", 1): "056d429e14c69ff1",
    ("tilted", 1): "95c1313499359d1f",
    ("clutter", 1): "df6133e38f57e558",
    ("geometry", 1): "740dc8d1af525d4d",
    ("clean", 1): "e75c397571b338aa",
    ("smoke", 1): "6ad2f3dacffec7d5",
    ("pairs-biased", 1): "480b762b311fee79",
    ("pairs-uncalibrated", 1): "1b2aae0b82eede74",
    ("pairs-distorted", 1): "97e7285fb0b3dd04",
    ("hard-noisy", 1): "9afa2c9f303d8ec9",
    ("hard-biased", 1): "ebb745251df7afd8",
    ("hard-uncalibrated", 1): "851a8fe0af52a3aa",
    ("hard-distorted", 1): "5cc26d26f5d32081",
    ("multi-noisy", 1): "5d5132d9f06bac8c",
    ("multi-biased", 1): "4a0905d3c87b2d54",
    ("multi-uncalibrated", 1): "811549e831d0f30d",
    ("multi-distorted", 1): "ba8d2002bc8062c0",
}


def digest(plans: list[ScenePlan]) -> str:
    """Of poses, parts, reported and true cameras, labels and marks, rounded to 1e-6."""
    text = []

    def numbers(values: object) -> None:
        # Adding zero makes a negative zero positive.
        text.append(" ".join(f"{value:.6f}" for value in np.round(np.ravel(values), 6) + 0.0))

    for plan in plans:
        for screw, labels, model in zip(plan.screws, plan.labels, plan.models, strict=True):
            text.append(f"{model.name} {sorted(labels.items())}")
            numbers(screw.world_from_cad)
            numbers(screw.upright_from_tower)
        for view in ("AP", "LAT"):
            # P's last column holds thousands of px mm: seven digits there are 1e-6 of what it is in mm.
            numbers(plan.cameras[view].projection / 1000.0)
            numbers(plan.true_cameras[view].projection / 1000.0)
            for mark in plan.annotations[view]:
                text.append(f"{view} {mark.label} {mark.model}")
                numbers([mark.tip_px, mark.center_px])
    return hashlib.sha256("\n".join(text).encode()).hexdigest()[:16]


def test_all_sets_are_there_with_their_sizes() -> None:
    assert {name: one.size for name, one in SETS.items()} == SIZES | SPOILED
    assert {recipe.name for recipe in RECIPES} == set(SIZES | SPOILED) - {"real", "other"}


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.name)
def test_a_version_of_a_set_is_frozen(recipe: SimulatedSet) -> None:
    key = (recipe.name, recipe.version)
    assert key in FROZEN, f"{key} is a new version: add its digest here, and say in the changelog what has changed"
    found = digest([recipe.plan(2026, index) for index in (0, 1)])
    assert found == FROZEN[key], (
        f"the cases of {recipe.name} have changed: give the set a new version in sets_simulated.py, and add it here "
        f"with the digest {found}. Figures of different versions are not comparable."
    )


def test_the_digest_sees_a_micrometre_and_a_label() -> None:
    plan = BY_NAME["smoke"].plan(1, 0)
    first, *others = plan.screws
    moved = first.world_from_cad + np.eye(4, k=3) * 0.001
    assert digest([plan]) == digest([BY_NAME["smoke"].plan(1, 0)])
    assert digest([plan]) != digest([replace(plan, screws=(replace(first, world_from_cad=moved), *others))])
    mark, *more = plan.annotations["AP"]
    assert digest([plan]) != digest([replace(plan, annotations={**plan.annotations, "AP": (*more, mark)})])


def test_any_case_alone_is_the_case_of_a_run() -> None:
    run = [BY_NAME["pairs"].plan(5, index) for index in range(3)]
    assert digest([BY_NAME["pairs"].plan(5, 2)]) == digest([run[2]])
    assert len({digest([plan]) for plan in run} | {digest([BY_NAME["pairs"].plan(6, 2)])}) == 4


def mean_epipolar_px(plan: ScenePlan, swapped: bool) -> float:
    marks = {
        view: {mark.label: np.stack([mark.tip_px, mark.center_px]) for mark in plan.annotations[view]}
        for view in ("AP", "LAT")
    }
    lat = [labels["LAT"] for labels in plan.labels]
    pairs = zip([labels["AP"] for labels in plan.labels], lat[::-1] if swapped else lat, strict=True)
    return float(
        np.mean(
            [
                np.diag(epipolar_distances_px(plan.cameras["AP"], plan.cameras["LAT"], marks["AP"][a], marks["LAT"][b]))
                for a, b in pairs
            ]
        )
    )


def test_hard_is_where_epipolar_lines_are_blind() -> None:
    for index in range(4):
        plan = BY_NAME["hard"].plan(1, index)
        assert abs(mean_epipolar_px(plan, True) - mean_epipolar_px(plan, False)) < 2.0
        assert len({mark.model for view in ("AP", "LAT") for mark in plan.annotations[view]}) == 1


def test_each_set_varies_what_it_is_for() -> None:
    multi = [BY_NAME["multi"].plan(1, index) for index in range(3)]
    assert all(3 <= len(plan.screws) <= 12 for plan in multi)
    assert len({len(plan.screws) for plan in multi}) >= 2
    assert any(plan.missing for plan in multi)
    assert all(len(plan.missing) <= 2 for plan in multi)
    assert all(3.0 <= screw.tower_tilt_deg <= 20.0 for screw in BY_NAME["tilted"].plan(1, 0).screws)
    assert BY_NAME["clutter"].plan(1, 0).options.clutter == (3, 8)
    drawn = [BY_NAME["geometry"].recipe(np.random.default_rng(seed))[1] for seed in range(60)]
    amounts = [one.rotation_error_deg for one in drawn]
    assert 0.1 <= min(amounts) < 0.2
    assert 1.5 < max(amounts) <= 2.0
    assert all(one.translation_error_mm == pytest.approx(3.0 * one.rotation_error_deg, abs=1e-3) for one in drawn)
    noise = [BY_NAME["pairs"].recipe(np.random.default_rng(seed))[1].landmark_noise_px for seed in range(60)]
    assert 0.5 <= min(noise) < 0.8 < 2.7 < max(noise) <= 3.0
    wrong = BY_NAME["geometry"].plan(1, 0)
    assert wrong.imperfections.rotation_error_deg > 0.0
    assert not np.array_equal(wrong.cameras["LAT"].projection, wrong.true_cameras["LAT"].projection)
    for name in ("hard", "clean"):
        plan = BY_NAME[name].plan(1, 0)
        for view in ("AP", "LAT"):
            np.testing.assert_array_equal(plan.cameras[view].projection, plan.true_cameras[view].projection)


def test_a_case_on_disk_says_what_was_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # As small as can be: this is about files.
    def small(rng: np.random.Generator) -> tuple:
        options, imperfections = BY_NAME["multi"].recipe(rng)
        return replace(options, screws=(3, 3), levels=(2, 2), image_size=(160, 160), missing=(1, 1)), imperfections

    path = replace(BY_NAME["multi"], recipe=small).make(1, 4, tmp_path / "case")
    scene = json.loads((path.parent / "scene.json").read_text())
    assert (scene["set"], scene["set_version"], scene["set_seed"], scene["index"]) == ("multi", 1, 1, 4)
    assert scene["case"] == "multi-1-0004" == read_truth(path.parent).case
    assert len(scene["missing"]) == 1
    assert scene["imperfections"]["landmark_noise_px"] == 1.5
    case = read_case(path)
    truth = read_truth(path.parent)
    (gone,) = scene["missing"]
    assert gone["view"] not in truth.screws[gone["screw"]].labels
    assert sum(len(marks) for marks in case.annotations.values()) == 5


@pytest.mark.parametrize("index", [-1, 5])
def test_a_case_beyond_the_set_is_refused(index: int) -> None:
    with pytest.raises(InputError, match=rf"--index: the set 'paper' has no case {index}; expected 0 to 4"):
        get_set("paper").check_index(index)


def test_an_endless_set_has_every_case() -> None:
    replace(get_set("paper"), size=None).check_index(10**9)


def test_other_needs_its_data(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("SCREWPOSE_DATA", raising=False)
    with pytest.raises(CaseError, match=r"the set `other` needs other people's screws and spines, and SCREWPOSE_DATA"):
        other_folder()
    monkeypatch.setenv("SCREWPOSE_DATA", str(tmp_path))
    with pytest.raises(CaseError, match=r"models\.json: this part of the data is not here; expected the data of the"):
        other_folder()


def test_other_holds_other_peoples_screws_and_spines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCREWPOSE_DATA", str(shared_data("screws_lassoan/models.json").parents[1]))
    spine, ct = plan_other(1, 0), plan_other(1, 1)
    assert ct.patient is not None
    assert spine.patient is not None
    assert ct.patient.volume is not None
    assert spine.patient.volume is None
    for plan in (spine, ct):
        assert all(name.startswith("scaled_") for name in plan.implants)
        for screw in plan.screws:
            # The tip of the metal is where the landmark is.
            lowest = ((screw.implant.mesh.vertices_mm - screw.implant.tip_mm) @ screw.implant.axis).min()
            assert abs(lowest) < 0.1
