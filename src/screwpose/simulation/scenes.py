"""Cases with known truth: pedicle screws in a patient, seen from the front and from the side.

Everything follows from the seed. The patient lies in an LPS world (mm), and the towers stand backwards out of the skin.
A scene is planned first (`plan_scene`: screws, cameras, marks) and then X-rayed (`xrayed`): trying an arrangement takes
a millisecond, so that scenes can be chosen before any is rendered.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import InputError
from screwpose.files.case import Annotation
from screwpose.files.result import PosedImplant
from screwpose.geometry.camera import Camera
from screwpose.implants.design import ScrewDesign
from screwpose.implants.model import Implant
from screwpose.simulation.arrangement import OUT_OF_FIELD, Arrangement, arranged, detector_width_mm, is_long
from screwpose.simulation.arrangement_overlap import covered_shares
from screwpose.simulation.arrangement_screws import PlacedScrew, drawn_designs, made_implants
from screwpose.simulation.detector import Detector
from screwpose.simulation.imperfections import Imperfections, reported_cameras, true_cameras
from screwpose.simulation.patient import Patient, parametric_patient
from screwpose.simulation.scenes_bodies import bodies_of_scene, needle_bodies, random_detector
from screwpose.simulation.scenes_marks import (
    VIEWS,
    MissingMark,
    annotated,
    epipolar_margin_px,
    is_inside,
    marked_px,
    marks_hidden,
    marks_outside,
)
from screwpose.simulation.scenes_options import SceneOptions, most_missing
from screwpose.simulation.streams import stream
from screwpose.simulation.xray import Body, SimulatedXray, render_views

PatientBuilder = Callable[[np.random.Generator], Patient]
"""Makes a patient from a generator."""


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """A scene before it is X-rayed: all that the truth, the cameras and the marks need.

    Parameters
    ----------
    screws : as they are in the patient at the time of AP.
    models : for each screw the implant that the solver is given for it.
    cameras, true_cameras : by view name, as the case reports them and as the images are made.
    annotations, labels : the marks by view; for each screw its label by view.
    missing : which marks there are not.
    covered : by view, for each screw the share of its silhouette that others cover.
    epipolar_margin_px : see `screwpose.simulation.scenes_marks.epipolar_margin_px`.
    """

    id: str
    seed: int
    options: SceneOptions
    imperfections: Imperfections
    patient: Patient | None
    screws: tuple[PlacedScrew, ...]
    models: tuple[Implant, ...]
    detector: Detector
    cameras: Mapping[str, Camera]
    true_cameras: Mapping[str, Camera]
    annotations: Mapping[str, tuple[Annotation, ...]]
    labels: tuple[Mapping[str, str], ...]
    missing: tuple[MissingMark, ...]
    covered: Mapping[str, FloatArray]
    epipolar_margin_px: float | None

    @property
    def overlap(self) -> dict[str, float]:
        """By view, the largest share of a screw's silhouette that others cover."""
        return {view: float(shares.max()) for view, shares in self.covered.items()}

    @property
    def implants(self) -> dict[str, Implant]:
        """By model name, what the solver is given."""
        return {implant.name: implant for implant in self.models}

    @property
    def posed(self) -> tuple[PosedImplant, ...]:
        """The truth: labels by view, model and pose."""
        return tuple(
            PosedImplant(labels, model.name, screw.world_from_cad)
            for labels, model, screw in zip(self.labels, self.models, self.screws, strict=True)
        )


@dataclass(frozen=True, eq=False)
class SimulatedView:
    """One X-ray, with its camera as the case reports it and as it was."""

    camera: Camera
    xray: SimulatedXray
    true_camera: Camera


@dataclass(frozen=True, eq=False)
class SimulatedCase:
    """A case, and the truth about it.

    Parameters
    ----------
    views : by name, AP and LAT.
    implants : by model name, as the solver is given them.
    annotations : by view name, what a person would have marked. Their labels say nothing across views.
    screws : the truth: labels by view, model and pose at the time of AP.
    parts : for each screw the pose of each of its parts; empty where it is rigid.
    overlap : by view name, the largest share of a screw's silhouette that others cover.
    needles : by a name for the acquisition: the X-rays by view with a needle along the tower of a screw, which is given
        by its place in `screws`.
    plan : what was drawn.
    """

    id: str
    seed: int
    views: Mapping[str, SimulatedView]
    implants: Mapping[str, Implant]
    annotations: Mapping[str, tuple[Annotation, ...]]
    screws: tuple[PosedImplant, ...]
    parts: tuple[Mapping[str, FloatArray], ...]
    overlap: Mapping[str, float]
    plan: ScenePlan
    needles: Mapping[str, "NeedleAcquisition"] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class NeedleAcquisition:
    """X-rays by view name with a needle along the tower of one screw, by its place in the truth."""

    screw: int
    xrays: Mapping[str, SimulatedXray]


def two_screw_scene(
    seed: int,
    *,
    landmark_noise_px: float = 1.5,
    image_size: tuple[int, int] = (1024, 1024),
    with_anatomy: bool = True,
    designs: tuple[ScrewDesign, ScrewDesign] | None = None,
) -> SimulatedCase:
    """Two pedicle screws with towers, of one level or of neighbours, overlapping in LAT.

    Parameters
    ----------
    seed : of everything. Seeds span overlaps in LAT from touching to complete.
    landmark_noise_px : standard deviation of the marks, in u and in v, Gaussian.
    image_size : (width, height) in px. The detector stays 307 mm wide: fewer pixels are larger ones.
    with_anatomy : False leaves the patient away: metal in air.
    designs : of the two screws; by default both are of one random design. Annotations name the model, which tells two
        different designs apart.

    Raises
    ------
    ScrewposeError
        No arrangement was found that shows both screws: the designs are too large for the field of view.
    """
    return simulate_scene(
        SceneOptions(image_size=image_size),
        Imperfections(landmark_noise_px=landmark_noise_px),
        seed,
        with_anatomy=with_anatomy,
        designs=designs,
    )


def simulate_scene(
    options: SceneOptions,
    imperfections: Imperfections,
    seed: int,
    *,
    case_id: str | None = None,
    patient: PatientBuilder = parametric_patient,
    with_anatomy: bool = True,
    designs: Sequence[ScrewDesign | Implant] | None = None,
) -> SimulatedCase:
    """Plan a scene and X-ray it; see `plan_scene`.

    Parameters
    ----------
    with_anatomy : False leaves the tissues away: metal in air, where it is in the patient.
    """
    return xrayed(
        plan_scene(options, imperfections, seed, case_id=case_id, patient=patient, designs=designs), with_anatomy
    )


def plan_scene(
    options: SceneOptions,
    imperfections: Imperfections,
    seed: int,
    *,
    case_id: str | None = None,
    patient: PatientBuilder = parametric_patient,
    designs: Sequence[ScrewDesign | Implant] | None = None,
) -> ScenePlan:
    """Draw a scene that is as the options want it.

    Parameters
    ----------
    seed : of everything; each thing has a stream of its own, so that a dial changes what it says and nothing else.
    case_id : None: from the number of screws and the seed.
    patient : makes the patient from a generator.
    designs : of each screw, made to measure or a given CAD; None: drawn.

    Raises
    ------
    InputError
        Designs that do not go with the options.
    ScrewposeError
        No such scene was found: the bounds contradict each other.
    """
    count = int(stream(seed, "count").integers(options.screws[0], options.screws[1] + 1))
    if designs is None:
        designs = drawn_designs(stream(seed, "designs"), options, count)
    elif not options.screws[0] <= len(designs) <= options.screws[1]:
        raise InputError(f"{len(designs)} designs", field="designs", expected="one for each screw")
    count = len(designs)
    in_patient, models = made_implants(tuple(designs)), made_implants(_as_given(designs, imperfections))
    who = patient(stream(seed, "patient"))
    draft = _Draft(options, imperfections, seed, count)
    arrangement = arranged(
        stream(seed, "layout"),
        options,
        who.levels,
        in_patient,
        lambda is_wide: draft.detector(is_wide).field_radius_px is not None,
        draft.refusal,
    )
    marked = draft.of(arrangement)
    assert marked.outside is not None  # `refusal` has seen to that
    covered = {view: covered_shares(marked.nominal[view], arrangement.screws) for view in VIEWS}
    missing = [*marked.outside, *marks_hidden(covered, marked.outside, draft.count_missing)]
    names = [model.name for model in models]
    annotations, labels = annotated(marked.marks, names, missing, options.models_named, stream(seed, "labels"))
    both = sorted(set(range(count)) - {mark.screw for mark in missing})
    return ScenePlan(
        id=case_id or (f"two-screws-{seed}" if count == 2 else f"screws-{count}-{seed}"),
        seed=seed,
        options=options,
        imperfections=imperfections,
        patient=who,
        screws=arrangement.screws,
        models=models,
        detector=draft.detector(is_long(arrangement.screws)),
        cameras=marked.reported,
        true_cameras=marked.true,
        annotations=annotations,
        labels=labels,
        missing=tuple(missing),
        covered=covered,
        epipolar_margin_px=epipolar_margin_px(marked.reported, marked.marks, both),
    )


@dataclass(frozen=True, eq=False)
class _Marked:
    """An arrangement with what its case would hold; `outside` is None where too many marks would be missing."""

    nominal: Mapping[str, Camera]
    true: Mapping[str, Camera]
    reported: Mapping[str, Camera]
    marks: Mapping[str, FloatArray]
    outside: list[MissingMark] | None


class _Draft:
    """What decides whether an arrangement will do, cheapest first."""

    def __init__(self, options: SceneOptions, imperfections: Imperfections, seed: int, count: int) -> None:
        self.options, self.imperfections, self.seed = options, imperfections, seed
        self._detectors = {is_wide: self._drawn_detector(is_wide) for is_wide in (False, True)}
        self.noise = stream(seed, "marks").standard_normal((count, len(VIEWS), 2, 2))
        asked = int(stream(seed, "missing").integers(options.missing[0], options.missing[1] + 1))
        self.count_missing = min(asked, most_missing(count))
        self.least_missing = min(options.missing[0], self.count_missing)

    def _drawn_detector(self, is_wide: bool) -> Detector:
        drawn = random_detector(
            stream(self.seed, "detector"),
            self.options.image_size,
            detector_width_mm(self.options, is_wide),
            0.0 if is_wide else self.options.round_field,
        )
        s_distortion_rad = float(np.radians(self.imperfections.s_distortion_deg))
        return replace(drawn, pincushion=self.imperfections.pincushion, s_distortion_rad=s_distortion_rad)

    def detector(self, is_wide: bool) -> Detector:
        """The C-arm of the case: another where screws over many levels take a large flat panel."""
        return self._detectors[is_wide]

    def of(self, arrangement: Arrangement) -> _Marked:
        """The cameras and the marks of an arrangement."""
        given = (arrangement.cameras, arrangement.isocenters, self.imperfections, self.seed)
        true = true_cameras(*given)
        marks = marked_px(
            arrangement.screws, true, self.imperfections, self.detector(is_long(arrangement.screws)), self.noise
        )
        # What a dial drives out of the image cannot be marked either.
        seen = {v: arrangement.in_field[v] & is_inside(marks[v], self.options.image_size) for v in VIEWS}
        outside = marks_outside(seen, most_missing(len(arrangement.screws)))
        return _Marked(arrangement.cameras, true, reported_cameras(*given), marks, outside)

    def refusal(self, arrangement: Arrangement) -> str | None:
        """What is wrong with an arrangement; None where nothing is."""
        options = self.options
        if marks_outside(arrangement.in_field, self.count_missing) is None:
            return OUT_OF_FIELD
        marked = self.of(arrangement)
        if marked.outside is None:
            return OUT_OF_FIELD
        if options.max_epipolar_gap_px is not None:
            margin = epipolar_margin_px(marked.reported, marked.marks, range(len(arrangement.screws)))
            if margin is None or abs(margin) >= options.max_epipolar_gap_px:
                return f"swapped labels change the epipolar distance by {options.max_epipolar_gap_px:g} px or more"
        if options.overlap_lat == (0.0, 1.0) and not self.least_missing:
            return None
        covered = {"LAT": covered_shares(arrangement.cameras["LAT"], arrangement.screws)}
        if not options.overlap_lat[0] <= float(covered["LAT"].max()) <= options.overlap_lat[1]:
            return "the overlap in LAT is not the one asked for"
        hidden = marks_hidden(covered, marked.outside, self.count_missing)
        if len(marked.outside) + len(hidden) < self.least_missing:
            return "not enough marks are missing"
        return None


def _as_given(
    designs: Sequence[ScrewDesign | Implant], imperfections: Imperfections
) -> tuple[ScrewDesign | Implant, ...]:
    """The CAD that the solver is given: the dials make it another one than was X-rayed."""
    longer, thicker = imperfections.cad_length_mm, imperfections.cad_diameter_mm
    if not longer and not thicker:
        return tuple(designs)
    given: list[ScrewDesign | Implant] = []
    for design in designs:
        if isinstance(design, Implant):
            raise InputError(
                f"a CAD mismatch for the given mesh {design.name}",
                field="cad_length_mm" if longer else "cad_diameter_mm",
                expected="screws that are made to measure",
            )
        given.append(
            replace(
                design,
                shank_length_mm=design.shank_length_mm + longer,
                shank_diameter_mm=design.shank_diameter_mm + thicker,
            )
        )
    return tuple(given)


def xrayed(plan: ScenePlan, with_anatomy: bool = True) -> SimulatedCase:
    """X-ray a planned scene."""
    bodies, volume = bodies_of_scene(plan.patient if with_anatomy else None, plan.screws, plan.options, plan.seed)

    def exposed(more: Sequence[Body], what: str) -> dict[str, SimulatedXray]:
        noise = {view: stream(plan.seed, f"noise {view} {what}") for view in VIEWS}
        return render_views(plan.true_cameras, [*bodies, *more], plan.detector, noise, volume)

    needles = {}
    for index, needle in enumerate(needle_bodies(plan.screws, plan.true_cameras) if plan.options.needles else ()):
        # By the label in AP, as one works; by that in LAT where AP has none.
        name = plan.labels[index].get("AP") or plan.labels[index]["LAT"]
        needles[name] = NeedleAcquisition(index, exposed([needle], f"needle {index}"))
    return SimulatedCase(
        id=plan.id,
        seed=plan.seed,
        views={
            view: SimulatedView(plan.cameras[view], xray, plan.true_cameras[view])
            for view, xray in exposed([], "").items()
        },
        implants=plan.implants,
        annotations=plan.annotations,
        screws=plan.posed,
        parts=tuple(screw.part_poses for screw in plan.screws),
        overlap=plan.overlap,
        plan=plan,
        needles=needles,
    )
