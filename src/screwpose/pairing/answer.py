"""From scored combinations to the answer: statuses, warnings, and the result file's keys."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose import __version__
from screwpose.files.case import Case
from screwpose.files.result import CombinationScene, PosedImplant, Result
from screwpose.files.schema import (
    CameraResultFile,
    ChosenBy,
    CombinationFile,
    PairingFile,
    ResultFile,
    Scores,
    ScrewResultFile,
    ScrewScores,
    SigmaFile,
    Software,
    StageScores,
    ViewScores,
    as_covariance6,
    as_matrix3x3,
    as_matrix3x4,
    as_point3,
    as_pose,
)
from screwpose.geometry import rigid
from screwpose.pairing.cameras import CamerasFit, in_cameras
from screwpose.pairing.confidence import Confidence
from screwpose.pairing.evidence import Evidence, Poses, score_each
from screwpose.pairing.hypotheses import Combination
from screwpose.pairing.landmark_fit import doubts_by_marks, landmark_offsets_px
from screwpose.pairing.ranking import Ranking
from screwpose.pairing.segment import LandmarkNoise
from screwpose.pairing.thickness import Quality
from screwpose.registration import Registered
from screwpose.registration.alternatives import SAME_SHIFT_MM, SAME_TURN_DEG, Rival
from screwpose.registration.uncertainty import ExpectedError
from screwpose.similarity import SceneScore

# Below the first a screw hardly covers metal in some view and someone should look; below the second it covers none.
_CHECK_DICE = 0.4
_FAILED_DICE = 0.1
# A registered screw whose outline meets edges of the image has a loss of some -0.03 or lower; noise gives some -0.002.
_CHECK_LOSS = -0.01
_PLACED_ONLY = (
    "the screws were placed on their landmarks and not registered: expect errors of a millimetre or two and some "
    "degrees, and do not rely on the roll about a screw's axis"
)
_SILHOUETTE_BIAS = (
    "the poses come from the paper's silhouette loss, which is biased: expect errors of a millimetre or two, "
    "and do not rely on the roll about a screw's axis (docs/benchmarks.md)"
)
_UNSEEN_ROLL = (
    "how far it is turned about its axis cannot be seen, since it looks much the same at other turns; its tip and axis "
    "hardly depend on it"
)
# On development cases rigid screws that came home explain 0.61 to 0.95 of the gradient energy near them in every view,
# screws whose towers lean 3 degrees and more at most 0.47 in one of them.
_CHECK_ENERGY = 0.5
_FAILED_ENERGY = 0.1


@dataclass(frozen=True, eq=False)
class Trial:
    """One combination through the steps; what was not registered has no `found` and no `post`.

    `quality` is there where it was registered by the thickness model.
    """

    combination: Combination
    probability: float
    placed: Poses
    pre: SceneScore
    found: Registered | None = None
    post: SceneScore | None = None
    quality: Quality | None = None


def refused(case: Case, reasons: Sequence[str], timing_s: dict[str, float]) -> Result:
    """The result where there is no answer: no screws, and the reasons."""
    unpaired = {view: tuple(mark.label for mark in marks) for view, marks in case.annotations.items()}
    answer = ResultFile(
        format="screwpose-result/1",
        case=case.id,
        software=Software(name="screwpose", version=__version__),
        status="refused",
        pairing=PairingFile(status="refused", pairs=(), unpaired=unpaired),
        combinations=(),
        screws=(),
        warnings=(*case.warnings, *reasons),
        timing_s=timing_s,
    )
    return Result(answer, ())


def answered(
    case: Case,
    evidence: Evidence,
    trials: Sequence[Trial],
    confidence: Confidence,
    ranking: Ranking,
    noise: LandmarkNoise,
    warnings: Sequence[str],
    timing_s: dict[str, float],
) -> Result:
    """The result whose first trial is the method's choice."""
    numbered = tuple(enumerate(trials, start=1))
    refined = None if trials[0].quality is None else trials[0].quality.cameras
    if refined is not None:  # the poses are in these cameras
        case, evidence = in_cameras(case, refined.cameras), replace(evidence, cameras=refined.cameras)
    screws, doubts, unseen = _screws(case, evidence, trials[0], noise, ranking.scale)
    status = "ambiguous" if confidence.status == "confident" and doubts else confidence.status
    unpaired = trials[0].combination.unpaired
    alone = [f"{view} {label} has no partner" for view, labels in unpaired.items() for label in labels]
    answer = ResultFile(
        format="screwpose-result/1",
        case=case.id,
        software=Software(name="screwpose", version=__version__),
        status=status,
        pairing=PairingFile(
            status=confidence.status,
            probability=confidence.probability,
            pairs=_pairs(trials[0].combination),
            unpaired=dict(unpaired),
            pair_probabilities=tuple(
                ranking.pair_probability(hypothesis.labels) for hypothesis in trials[0].combination.hypotheses
            ),
            unpaired_probabilities={
                view: tuple(ranking.alone_probability(view, label) for label in labels)
                for view, labels in unpaired.items()
            },
            chosen_by=ChosenBy(
                pre=max(numbered, key=lambda one: one[1].pre.dice)[0],
                post=max(
                    ((number, trial.post.dice) for number, trial in numbered if trial.post is not None),
                    key=lambda one: one[1],
                    default=(None, 0.0),
                )[0],
            ),
        ),
        combinations=tuple(
            CombinationFile(
                id=number,
                pairs=_pairs(trial.combination),
                probability=trial.probability,
                pre=_stage(trial.pre),
                post=None if trial.post is None else _stage(trial.post),
            )
            for number, trial in numbered
        ),
        screws=screws,
        cameras=None if refined is None or not refined.corrections else _cameras(refined),
        warnings=(
            *case.warnings,
            *warnings,
            *confidence.reasons,
            *doubts,
            *unseen,
            *alone,
            *_about_the_poses(trials[0]),
        ),
        timing_s=timing_s,
    )
    scenes = tuple(
        CombinationScene(
            number,
            _posed(trial.combination, trial.placed),
            () if trial.found is None else _posed(trial.combination, trial.found.world_from_cad),
        )
        for number, trial in numbered
    )
    return Result(answer, scenes)


def _about_the_poses(trial: Trial) -> list[str]:
    """What a reader must know of all poses."""
    if trial.quality is not None:
        return [] if trial.quality.cameras is None else list(trial.quality.cameras.words)
    return [_PLACED_ONLY if trial.found is None else _SILHOUETTE_BIAS]


def _cameras(refined: CamerasFit) -> dict[str, CameraResultFile]:
    """The refined cameras, and what was done to the reported ones."""
    cameras = refined.cameras
    return {
        name: CameraResultFile(
            projection=as_matrix3x4(cameras[name].projection),
            rotation_deg=float(np.degrees(np.linalg.norm(correction.parameters[:3]))),
            translation_mm=float(np.linalg.norm(correction.shift_mm)),
            focal_percent=100.0 * float(np.expm1(correction.log_focal)),
            principal_point_px=(float(correction.principal_point_px[0]), float(correction.principal_point_px[1])),
        )
        for name, correction in refined.corrections.items()
    }


def _screws(
    case: Case, evidence: Evidence, trial: Trial, noise: LandmarkNoise, scale: float
) -> tuple[tuple[ScrewResultFile, ...], list[str], list[str]]:
    """Each screw's pose and status, and in words why one is in doubt, and what of one cannot be seen."""
    combination = trial.combination
    poses = trial.placed if trial.found is None else trial.found.world_from_cad
    pre = score_each(evidence, combination, trial.placed)
    post = score_each(evidence, combination, poses)
    screws, doubts, unseen = [], [], []
    for index, (hypothesis, pose) in enumerate(zip(combination.hypotheses, poses, strict=True)):
        implant = evidence.implants[hypothesis.model]
        sigma = None
        if trial.quality is None:
            words, has_failed = _doubts_by_silhouette(post[index])
        else:
            words, has_failed = _doubts_by_energy(trial.quality.energies[index])
            if trial.quality.beside_px and trial.quality.beside_px[index]:
                words.append(_doubt_by_views(trial.quality.beside_px[index]))
            rivals = [rival for rival in trial.quality.rivals if rival.index == index]
            if trial.quality.errors and not words:  # what fits so badly says little of its errors
                error = trial.quality.errors[index]
                sigma = _sigma(error, rivals)
                unseen += [f"screw {hypothesis.name}: {_UNSEEN_ROLL}"] if error.roll_deg is None else []
            words += [_doubt_by_rival(rival) for rival in rivals]
            turns_deg = [abs(one.turn_deg) for one in trial.quality.alike if one.index == index]
            alike = dict.fromkeys(_alike(turn) for turn in sorted(turns_deg) if turn > SAME_TURN_DEG)
            unseen += [f"screw {hypothesis.name}: {words}" for words in alike]
        if trial.found is not None and trial.found.at_bound[index]:
            words.append(
                "the search ended near its bounds: the marks started it too far off, or the loss drew it away from them"
            )
        offsets_px = landmark_offsets_px(case, implant, hypothesis.by_view, pose)
        words += doubts_by_marks(offsets_px, noise.sigma_px, scale)
        doubts += [f"screw {hypothesis.name}: {word}" for word in words]
        screws.append(
            ScrewResultFile(
                labels=hypothesis.by_view,
                model=hypothesis.model,
                status="failed" if has_failed else "check" if words else "ok",
                world_from_cad=as_pose(pose),
                tip=as_point3(rigid.transform(pose, implant.tip_mm)),
                center=as_point3(rigid.transform(pose, implant.center_mm)),
                axis=as_point3(pose[:3, :3] @ implant.axis),
                sigma=sigma,
                scores=ScrewScores(pre=_scores(pre[index]), post=None if trial.found is None else _scores(post[index])),
            )
        )
    return tuple(screws), doubts, unseen


def _sigma(error: ExpectedError, rivals: Sequence[Rival]) -> SigmaFile:
    """How far a pose may be off, less what it is not known to: another pose may explain the X-rays as well."""
    if rivals:
        error = error.without_roll()
    tip_is_known = all(abs(rival.shift_mm) <= SAME_SHIFT_MM for rival in rivals)
    to_degrees = np.repeat([np.degrees(1.0), 1.0], 3)
    return SigmaFile(
        tip_mm=error.tip_mm if tip_is_known else None,
        axis_deg=error.axis_deg,
        roll_deg=error.roll_deg,
        tip_covariance_mm2=as_matrix3x3(error.tip_covariance_mm2) if tip_is_known else None,
        pose_covariance=None
        if error.covariance is None
        else as_covariance6(error.covariance * np.outer(to_degrees, to_degrees)),
    )


def _doubts_by_silhouette(scores: SceneScore) -> tuple[list[str], bool]:
    """What the scores of a screw's own mask hold against it, and whether it covers nothing."""
    worst_view, worst = min(scores.views.items(), key=lambda item: item[1].dice)
    words = [f"it covers little metal in {worst_view} (Dice {worst.dice:.2f})"] if worst.dice < _CHECK_DICE else []
    words += [
        f"its outline meets no edges in {view} (loss {score.loss:.3f})"
        for view, score in scores.views.items()
        if score.loss > _CHECK_LOSS
    ]
    return words, worst.dice < _FAILED_DICE


def _doubts_by_energy(energies: Mapping[str, float]) -> tuple[list[str], bool]:
    """What the explained energy holds against a screw, and whether it explains nothing.

    It asks the X-ray itself; the Dice score asks a segmentation, which finds little of a pale tower in bright air.
    """
    words = [
        f"its model explains little of the edges in {view} (energy {energy:.2f})"
        for view, energy in energies.items()
        if energy < _CHECK_ENERGY
    ]
    return words, min(energies.values()) < _FAILED_ENERGY


def _doubt_by_views(beside_px: Mapping[str, float]) -> str:
    """What a reader must know where the views do not agree on where a screw lies."""
    ways = " and ".join(f"{view} alone would have it {beside:.1f} px elsewhere" for view, beside in beside_px.items())
    return (
        f"the views do not agree on where it lies: {ways}; if the projection matrices may be off, let them be refined "
        "with the poses (--cameras auto), and if the images are distorted, correct that first"
    )


def _alike(turn_deg: float) -> str:
    """What a reader must know of a screw that looks the same at another turn."""
    turn = "half a turn" if turn_deg > 170 else f"{turn_deg:.0f} degrees"
    return f"its model looks the same after {turn} about its axis: its roll, and the roll's sigma, hold but for that"


def _doubt_by_rival(rival: Rival) -> str:
    """What a reader must know of another pose that explains the images as well."""
    ways = []
    if abs(rival.turn_deg) > SAME_TURN_DEG:
        turn = "half a turn" if abs(rival.turn_deg) > 150.0 else f"{abs(rival.turn_deg):.0f} degrees"
        ways.append(f"its roll may be {turn} off")
    if abs(rival.shift_mm) > SAME_SHIFT_MM:
        ways.append(f"it may sit {abs(rival.shift_mm):.1f} mm {'higher' if rival.shift_mm > 0.0 else 'deeper'}")
    return f"the X-rays do not tell one pose from another: {' and '.join(ways)} ({rival.preference:.1f} sigma)"


def _pairs(combination: Combination) -> tuple[dict[str, str], ...]:
    return tuple(hypothesis.by_view for hypothesis in combination.hypotheses)


def _posed(combination: Combination, poses: Poses) -> tuple[PosedImplant, ...]:
    return tuple(
        PosedImplant(hypothesis.by_view, hypothesis.model, pose)
        for hypothesis, pose in zip(combination.hypotheses, poses, strict=True)
    )


def _scores(score: SceneScore) -> Scores:
    return Scores(dice=score.dice, loss=score.loss)


def _stage(score: SceneScore) -> StageScores:
    views = {name: ViewScores(dice=view.dice, loss=view.loss) for name, view in score.views.items()}
    return StageScores(dice=score.dice, loss=score.loss, views=views)
