"""How good is the pairing by landmarks alone, how honest its probability, and which mistakes does it find?

    python benchmarks/pairing_by_landmarks.py --set pairs,hard,multi --count 300 --seed 1

No image is rendered. Scenes of the sets are marked in each condition (exact as the set says, half and twice as exact,
the centre 5 px off, P off by 2 % and 1 degree, distortion of 2 px) and paired; the solver always assumes the same
noise. Then, in the first condition, the mistakes of a person are made, and it is counted how often they are found and
named.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter

import numpy as np
from landmark_scenes import CONDITIONS, Scene, drawn_scenes, marked
from rich.console import Console
from rich.progress import track

from screwpose._types import FloatArray
from screwpose.files.case import Annotation, Case
from screwpose.pairing import LandmarkNoise, judge, ranked_pairings
from screwpose.pairing.plausibility import check_plausibility
from screwpose.report.tables import Column, Table

_BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 1.0)
_SURE = 0.99


@dataclass(frozen=True)
class Outcome:
    """What came of one case.

    Parameters
    ----------
    right : whether all pairs are the true ones, and no more.
    pairs : for each answered pair and each mark that was left alone its probability, and whether it is right.
    true_pairs : how many there are, and how many of them were answered.
    alone : the appearances of screws that one view alone shows, and how many of them were left without a partner.
    """

    right: bool
    status: str
    probability: float
    pairs: tuple[tuple[float, bool], ...]
    true_pairs: tuple[int, int]
    alone: tuple[int, int]
    scale: float
    words: str
    seconds: float


def outcome(scene: Scene, case: Case, noise: LandmarkNoise) -> Outcome:
    """Pair a case by its landmarks and judge it, as solving does before it looks at the images."""
    start = perf_counter()
    findings = check_plausibility(case, noise)
    ranking = ranked_pairings(case, noise)
    seconds = perf_counter() - start
    words = " ".join(finding.within_file() for finding in findings)
    shown = ranking.shown(6)
    once = [next(iter(labels.items())) for labels in scene.labels if len(labels) == 1]
    if not shown or any(finding.level == "error" for finding in findings):
        return Outcome(False, "refused", 0.0, (), (len(scene.truth), 0), (len(once), len(once)), 1.0, words, seconds)
    best, probability = shown[0], float(ranking.probabilities[0])
    verdict = judge(shown, 0, probability)
    status = "ambiguous" if findings and verdict.status == "confident" else verdict.status
    answered = {frozenset(one.labels) for one in best.hypotheses}
    pairs = [(ranking.pair_probability(one.labels), frozenset(one.labels) in scene.truth) for one in best.hypotheses]
    taken = {key for pair in scene.truth for key in pair}
    for view, labels in best.unpaired.items():
        pairs += [(ranking.alone_probability(view, label), (view, label) not in taken) for label in labels]
        words += "".join(f" {view} {label} has no partner." for label in labels)
    joined = {key for pair in answered for key in pair}
    return Outcome(
        answered == scene.truth,
        status,
        probability,
        tuple(pairs),
        (len(scene.truth), len(answered & scene.truth)),
        (len(once), sum(key not in joined for key in once)),
        ranking.scale,
        f"{words} {' '.join(verdict.reasons)}",
        seconds,
    )


def calibration_error(said: FloatArray, right: FloatArray) -> float:
    """Expected calibration error: by how much the mean of what is said misses the share that is right, over bins."""
    which = np.digitize(said, _BINS[1:-1])
    errors = [np.mean(which == b) * abs(said[which == b].mean() - right[which == b].mean()) for b in np.unique(which)]
    return float(np.sum(errors))


def wilson(successes: int, trials: int) -> str:
    """A share in percent with its 95 % interval (Wilson, 1927)."""
    if trials == 0:
        return "-"
    z, p = 1.96, successes / trials
    middle = (p + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z * np.sqrt(p * (1 - p) / trials + z**2 / (4 * trials**2)) / (1 + z**2 / trials)
    return f"{100 * p:.1f} ({100 * max(middle - half, 0.0):.1f}-{100 * min(middle + half, 1.0):.1f})"


def row_of(name: str, condition: str, seen: Sequence[Outcome]) -> tuple[str | float, ...]:
    """One row of the first table."""
    answered = [one for one in seen if one.status != "refused"]
    said = np.array([one.probability for one in answered])
    right = np.array([float(one.right) for one in answered])
    of_pairs = np.array([pair for one in answered for pair in one.pairs], dtype=float).reshape(-1, 2)
    wrong = sum(one.status == "confident" and not one.right for one in seen)
    return (
        name,
        condition,
        wilson(sum(one.right for one in seen), len(seen)),
        wilson(sum(one.true_pairs[1] for one in seen), sum(one.true_pairs[0] for one in seen)),
        wilson(sum(one.alone[1] for one in seen), sum(one.alone[0] for one in seen)),
        wilson(sum(one.status == "confident" for one in seen), len(seen)),
        wilson(wrong, len(seen)),
        wilson(sum(one.status == "refused" for one in seen), len(seen)),
        f"{np.mean((said - right) ** 2):.4f}",
        f"{100 * calibration_error(said, right):.1f}",
        f"{100 * calibration_error(*of_pairs.T):.2f}",
        f"{np.mean([one.scale for one in answered]):.2f}",
        f"{1000 * np.median([one.seconds for one in seen]):.0f}",
    )


_COLUMNS = (
    "Set", "Marked", "right, %", "pairs, %", "left alone, %", "confident, %", "confident and wrong, %", "refused, %",
    "Brier", "ECE, %", "ECE of pairs, %", "noise", "ms",
)  # fmt: skip


def reliability(seen: Sequence[Outcome]) -> list[tuple[str | float, ...]]:
    """By bins of what is said, how much is right: of whole pairings and of single pairs."""
    rows: list[tuple[str | float, ...]] = []
    whole = np.array([(one.probability, one.right) for one in seen if one.status != "refused"], dtype=float)
    single = np.array([pair for one in seen for pair in one.pairs], dtype=float)
    for low, high in pairwise(_BINS):
        cells = []
        for said, right in (whole.T, single.T):
            inside = (said >= low) & ((said < high) | (high == 1.0))
            count = int(inside.sum())
            cells += [str(count), f"{100 * said[inside].mean():.1f}" if count else "-"]
            cells.append(wilson(int(right[inside].sum()), count))
        rows.append((f"{low:g}-{high:g}", *cells))
    return rows


Mistake = Callable[[Case, Scene, np.random.Generator], tuple[Case, list[str]]]
"""Makes a mistake in a case; also the words of which one has to be said where it is named."""


def _drawn(case: Case, scene: Scene, rng: np.random.Generator) -> tuple[str, int, list[str]]:
    """A mark of a screw that both views show: its view and index; and what the screw is called."""
    both = [labels for labels in scene.labels if len(labels) == len(case.views)]
    labels = both[rng.integers(len(both))]
    view = str(rng.choice(list(case.views)))
    index = next(i for i, mark in enumerate(case.annotations[view]) if mark.label == labels[view])
    names = [f"{name} {label}" for name, label in labels.items()]
    return view, index, [*names, *(f"screw {label} in {name}" for name, label in labels.items())]


def _with(case: Case, view: str, marks: Sequence[Annotation]) -> Case:
    return replace(case, annotations={**case.annotations, view: tuple(marks)})


def ends_swapped(case: Case, scene: Scene, rng: np.random.Generator) -> tuple[Case, list[str]]:
    """Tip and centre of one mark."""
    view, index, names = _drawn(case, scene, rng)
    marks = list(case.annotations[view])
    marks[index] = replace(marks[index], tip_px=marks[index].center_px, center_px=marks[index].tip_px)
    return _with(case, view, marks), names


def one_end_off(case: Case, scene: Scene, rng: np.random.Generator) -> tuple[Case, list[str]]:
    """Tip or centre of one mark, 20 px off in any direction."""
    view, index, names = _drawn(case, scene, rng)
    marks = list(case.annotations[view])
    angle = rng.uniform(0, 2 * np.pi)
    off, mark = 20.0 * np.array([np.cos(angle), np.sin(angle)]), marks[index]
    is_tip = rng.random() < 0.5
    marks[index] = replace(mark, tip_px=mark.tip_px + off) if is_tip else replace(mark, center_px=mark.center_px + off)
    return _with(case, view, marks), names


def marked_twice(case: Case, scene: Scene, rng: np.random.Generator) -> tuple[Case, list[str]]:
    """One screw again in one view, with noise of its own."""
    view, index, _ = _drawn(case, scene, rng)
    mark = case.annotations[view][index]
    noise = scene.noise_px * rng.normal(size=(2, 2))
    again = replace(mark, label="again", tip_px=mark.tip_px + noise[0], center_px=mark.center_px + noise[1])
    return _with(case, view, [*case.annotations[view], again]), ["again"]


def no_screw(case: Case, scene: Scene, rng: np.random.Generator) -> tuple[Case, list[str]]:
    """Something of a screw's length within 200 px of the screws in one view."""
    view, index, _ = _drawn(case, scene, rng)
    marks = case.annotations[view]
    tip = np.mean([mark.tip_px for mark in marks], axis=0) + rng.uniform(-200, 200, 2)
    length, angle = np.linalg.norm(marks[index].tip_px - marks[index].center_px), rng.uniform(0, 2 * np.pi)
    center = tip + length * np.array([np.cos(angle), np.sin(angle)])
    return _with(case, view, [*marks, Annotation("stray", tip, center, marks[index].model)]), ["stray"]


def views_exchanged(case: Case, _scene: Scene, _rng: np.random.Generator) -> tuple[Case, list[str]]:
    """The matrices of both views."""
    first, second = case.views
    one, other = case.views[first], case.views[second]
    views = {first: replace(one, camera=other.camera), second: replace(other, camera=one.camera)}
    return replace(case, views=views), ["change places"]


MISTAKES: dict[str, Mistake] = {
    "none": lambda case, _scene, _rng: (case, []),
    "tip and centre swapped": ends_swapped,
    "an end 20 px off": one_end_off,
    "a screw marked twice": marked_twice,
    "a mark of no screw": no_screw,
    "views exchanged": views_exchanged,
}


def mistake_rows(name: str, scenes: Sequence[Scene], noise: LandmarkNoise) -> list[tuple[str | float, ...]]:
    """For each mistake, how often it is named, and what the status is; without any, how often one is."""
    rows: list[tuple[str | float, ...]] = []
    for what, make in MISTAKES.items():
        named, sure, wrong = 0, 0, 0
        for scene in scenes:
            right_case = marked(scene, CONDITIONS["as the set"])
            case, names = make(right_case, scene, np.random.default_rng([scene.seed, 7]))
            seen = outcome(scene, case, noise)
            named += any(one in seen.words for one in names)
            if not names:
                named += bool(check_plausibility(case, noise))
            sure += seen.status == "confident"
            wrong += seen.status == "confident" and not seen.right
        rows.append((name, what, *(wilson(count, len(scenes)) for count in (named, sure, wrong))))
    return rows


def main() -> None:
    """Print the tables."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--set", default="pairs,hard,multi", help="sets, with commas between")
    arguments.add_argument("--count", type=int, default=300, help="scenes of each set")
    arguments.add_argument("--seed", type=int, default=1, help="of the scenes")
    arguments.add_argument("--sigma", type=float, default=2.0, help="noise that the solver assumes, px")
    arguments.add_argument("--mistakes", type=int, default=100, help="scenes of each set in which mistakes are made")
    given = arguments.parse_args()
    noise, progress = LandmarkNoise(sigma_px=given.sigma), Console(stderr=True)
    rows, mistakes, all_seen = [], [], []
    for name in given.set.split(","):
        scenes = list(
            track(drawn_scenes(name, given.seed, given.count), f"{name}: scenes", given.count, console=progress)
        )
        for label, condition in CONDITIONS.items():
            cases = track(scenes, f"{name}: {label}", console=progress)
            seen = [outcome(scene, marked(scene, condition), noise) for scene in cases]
            rows.append(row_of(name, label, seen))
            all_seen += seen
        mistakes += mistake_rows(name, scenes[: given.mistakes], noise)
    title = f"{given.count} scenes of each set, seed {given.seed}, assumed noise {given.sigma:g} px"
    _print(title, _COLUMNS, rows)
    said = ("n", "said, %", "right, %")
    _print("Reliability over all of these", ("Said", *said, *(f"pairs: {one}" for one in said)), reliability(all_seen))
    _print("Mistakes", ("Set", "Mistake", "named, %", "confident, %", "confident and wrong, %"), mistakes)


def _print(title: str, columns: Sequence[str], rows: Sequence[tuple[str | float, ...]]) -> None:
    made = tuple(Column(name, name, is_number=False) for name in columns)
    Console().print(Table(title, made, tuple(rows)).to_markdown(), markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
