"""How good is the pairing by landmarks alone, and how honest its confidence? No image is rendered.

    python benchmarks/pairing_by_landmarks.py --count 500 --seed 1

Two-screw arrangements of the simulator are marked with several amounts of noise; the solver always assumes the same.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from screwpose.files.case import Annotation, Case, View
from screwpose.images.radiograph import Radiograph
from screwpose.pairing import LandmarkNoise, combinations, judge
from screwpose.pairing.plausibility import check_plausibility
from screwpose.report.tables import Column, Table
from screwpose.simulation import Imperfections, SceneOptions, ScenePlan, plan_scene

_NOISE_PX = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)


def marked_case(scene: ScenePlan, noise_px: float, rng: np.random.Generator) -> Case:
    """A case of landmarks alone; the true pairs have the same number in both views."""
    blank, everywhere = Radiograph(np.zeros((1, 1), np.float32)), np.ones((1, 1), np.bool_)
    annotations = {
        name: tuple(
            Annotation(
                f"{name}{i}", *(camera.project(screw.landmarks_in_world_mm) + noise_px * rng.normal(size=(2, 2)))
            )
            for i, screw in enumerate(scene.screws)
        )
        for name, camera in scene.cameras.items()
    }
    views = {name: View(name, camera, blank, everywhere) for name, camera in scene.cameras.items()}
    return Case("landmarks", views, scene.implants, annotations, Path("case.json"))


def swapped(case: Case) -> Case:
    """The same with the matrices of both views exchanged."""
    first, second = case.views
    one, other = case.views[first], case.views[second]
    return replace(case, views={first: replace(one, camera=other.camera), second: replace(other, camera=one.camera)})


def outcome(case: Case, noise: LandmarkNoise) -> tuple[bool, str]:
    """Whether the best combination is right, and its status; a warning of `check` makes it ambiguous, as in solving."""
    ranked = combinations(case, noise, 2)
    if not ranked:
        return False, "refused"
    numbers = [{label[-1] for _, label in hypothesis.labels} for hypothesis in ranked[0].hypotheses]
    right = len(numbers) == 2 and all(len(pair) == 1 for pair in numbers)
    status = judge(ranked, 0).status
    findings = check_plausibility(case, noise)
    if any(finding.level == "error" for finding in findings):
        status = "refused"
    elif findings and status == "confident":
        status = "ambiguous"
    return right, status


def main() -> None:
    """Print one row for each amount of noise, and for swapped views."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--count", type=int, default=500, help="arrangements")
    arguments.add_argument("--seed", type=int, default=1, help="of the arrangements")
    arguments.add_argument("--sigma", type=float, default=2.0, help="noise that the solver assumes, px")
    given = arguments.parse_args()
    noise = LandmarkNoise(sigma_px=given.sigma)
    seen: dict[str, list[tuple[bool, str]]] = {}
    for index in track(range(given.count), console=Console(stderr=True)):
        seed = int(np.random.SeedSequence([given.seed, index]).generate_state(1)[0])
        scene = plan_scene(SceneOptions(), Imperfections(), seed)
        rng = np.random.default_rng(seed)
        for noise_px in _NOISE_PX:
            case = marked_case(scene, noise_px, rng)
            seen.setdefault(f"{noise_px:g} px", []).append(outcome(case, noise))
            if noise_px == 1.5:
                seen.setdefault("1.5 px, matrices swapped", []).append((False, outcome(swapped(case), noise)[1]))
    columns = [Column("noise", "Marked with", is_number=False)]
    columns += [Column(name, name) for name in ("right", "confident", "ambiguous", "refused", "confident and wrong")]
    rows = []
    for name, outcomes in seen.items():
        share = [float(np.mean([status == kind for _, status in outcomes])) for kind in columns_of_status()]
        wrong = float(np.mean([status == "confident" and not right for right, status in outcomes]))
        right_share = None if "swapped" in name else float(np.mean([right for right, _ in outcomes]))
        rows.append((name, right_share, *share, wrong))
    table = Table(f"{given.count} arrangements, assumed noise {given.sigma:g} px", tuple(columns), tuple(rows))
    Console().print(table.to_markdown(), markup=False, soft_wrap=True)


def columns_of_status() -> tuple[str, ...]:
    """The statuses, in the order of the columns."""
    return ("confident", "ambiguous", "refused")


if __name__ == "__main__":
    main()
