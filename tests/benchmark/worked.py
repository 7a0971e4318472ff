"""A case small enough to be worked by hand: square bars before two cameras that look along z and along x."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark.record import CaseRecord, PoseErrors, ScrewRecord, score_case
from screwpose.files.case import Annotation, Case, View
from screwpose.files.result import CombinationScene, PosedImplant, Result
from screwpose.files.schema import (
    ChosenBy,
    CombinationFile,
    PairingFile,
    ResultFile,
    ScrewResultFile,
    SigmaFile,
    Software,
    StageScores,
    TruthFile,
    TruthScrew,
    as_matrix3x3,
    as_point3,
    as_pose,
)
from screwpose.geometry import Camera, rigid
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant, Mesh, Part

SIZE = 400
FOCAL_PX = 5000.0
DISTANCE_MM = 1000.0  # 5 px a mm at the world's origin


def camera(rotation: FloatArray) -> Camera:
    """A camera that looks at the origin from 1000 mm; rows of the rotation are u, v and the viewing axis."""
    K = np.array([[FOCAL_PX, 0, SIZE / 2], [0, FOCAL_PX, SIZE / 2], [0, 0, 1]])
    return Camera.from_matrix(K @ np.column_stack([rotation, [0, 0, DISTANCE_MM]]), (SIZE, SIZE))


AP = camera(np.eye(3))
LAT = camera(np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]))


def box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """A box between two corners, its faces turned outwards."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(corners.astype(float), np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]))


BAR = Implant(
    "bar",
    box((-5, 0, -5), (5, 30, 5)),
    np.zeros(3),
    np.array([0, 15.0, 0]),
    parts=(Part("shank", box((-5, 0, -5), (5, 20, 5))), Part("tower", box((-5, 20, -5), (5, 30, 5)))),
    pivot_mm=np.array([0, 20.0, 0]),
)


def shifted(x: float, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """A pose that only moves."""
    return rigid.exp(np.array([0, 0, 0, x, y, z]))


def turned(axis: Sequence[float], degrees: float, about: FloatArray | None = None) -> FloatArray:
    """A motion that turns about a line through a point (the origin)."""
    point = np.zeros(3) if about is None else about
    return rigid.rotation_about_line(point, np.array(axis, dtype=float), np.radians(degrees))


TRUE_POSES = (shifted(-12.0), shifted(12.0, 3.0))
LABELS = ({"AP": "1", "LAT": "b"}, {"AP": "2", "LAT": "a"})
SWAPPED = ({"AP": "1", "LAT": "a"}, {"AP": "2", "LAT": "b"})


def truth_of(
    poses: Sequence[FloatArray] = TRUE_POSES,
    labels: Sequence[dict[str, str]] = LABELS,
    parts: dict[str, FloatArray] | None = None,
) -> TruthFile:
    """The truth; `parts` are those of every screw."""
    rows = None if parts is None else {name: as_pose(pose) for name, pose in parts.items()}
    return TruthFile(
        format="screwpose-truth/1",
        case="by-hand",
        screws=tuple(
            TruthScrew(labels=label, model="bar", world_from_cad=as_pose(pose), parts=rows)
            for label, pose in zip(labels, poses, strict=True)
        ),
    )


def case_of(truth: TruthFile | None = None, noise_px: Sequence[float] = (0.0, 0.0)) -> Case:
    """The case of a truth, every mark off by the same (u, v)."""
    truth = truth or truth_of()
    cameras = {"AP": AP, "LAT": LAT}
    marks: dict[str, list[Annotation]] = {name: [] for name in cameras}
    for screw in truth.screws:
        points = rigid.transform(np.array(screw.world_from_cad), np.array([BAR.tip_mm, BAR.center_mm]))
        for view, label in screw.labels.items():
            tip, center = cameras[view].project(points) + np.asarray(noise_px)
            marks[view].append(Annotation(label, tip, center, "bar"))
    blank = Radiograph(np.zeros((SIZE, SIZE), np.float32))
    views = {name: View(name, one, blank, np.ones((SIZE, SIZE), bool)) for name, one in cameras.items()}
    return Case("by-hand", views, {"bar": BAR}, {name: tuple(some) for name, some in marks.items()}, Path("case.json"))


def scores(dice: float, loss: float) -> StageScores:
    """Scores of a combination."""
    return StageScores(dice=dice, loss=loss, views={})


def result_of(
    poses: Sequence[FloatArray] = TRUE_POSES,
    labels: Sequence[dict[str, str]] = LABELS,
    *,
    status: str = "confident",
    probability: float | None = 0.9,
    starts: Sequence[FloatArray] | None = None,
    parts: dict[str, FloatArray] | None = None,
    sigma_mm: float | None = None,
) -> Result:
    """An answer with two combinations, the answered one first."""
    screws = []
    for label, pose in zip(labels, poses, strict=True):
        covariance = None if sigma_mm is None else as_matrix3x3(np.eye(3) * sigma_mm**2)
        screws.append(
            ScrewResultFile(
                labels=label,
                model="bar",
                status="ok",
                world_from_cad=as_pose(pose),
                tip=as_point3(rigid.transform(pose, BAR.tip_mm)),
                center=as_point3(rigid.transform(pose, BAR.center_mm)),
                axis=as_point3(pose[:3, :3] @ BAR.axis),
                parts=None
                if parts is None
                else {name: {"world_from_cad": as_pose(one)} for name, one in parts.items()},  # type: ignore[misc]
                sigma=None if covariance is None else SigmaFile(tip_mm=sigma_mm, tip_covariance_mm2=covariance),
            )
        )
    other = SWAPPED if tuple(labels) == LABELS else LABELS
    combinations = (
        CombinationFile(id=1, pairs=tuple(labels), pre=scores(0.8, -0.2), post=scores(0.9, -0.4)),
        CombinationFile(id=2, pairs=other, pre=scores(0.7, -0.05), post=scores(0.6, -0.1)),
    )
    refused = status == "refused"
    answer = ResultFile(
        format="screwpose-result/1",
        case="by-hand",
        software=Software(name="screwpose", version="0"),
        status=status,  # type: ignore[arg-type]  # a Literal
        pairing=PairingFile(
            status=status,  # type: ignore[arg-type]
            probability=None if refused else probability,
            pairs=() if refused else tuple(labels),
            unpaired={},
            chosen_by=None if refused else ChosenBy(pre=1, post=1),
        ),
        combinations=() if refused else combinations,
        screws=() if refused else tuple(screws),
        warnings=("the marks contradict each other",) if refused else (),
        timing_s={"pairing": 1.0, "total": 2.0},
    )
    placed = tuple(PosedImplant(label, "bar", pose) for label, pose in zip(labels, starts or poses, strict=True))
    return Result(answer, () if refused else (CombinationScene(1, placed, placed),))


def record_of(result: Result | None = None, truth: TruthFile | None = None, index: int = 0) -> CaseRecord:
    """The record of an answer."""
    truth = truth or truth_of()
    return score_case(
        case_of(truth),
        result or result_of(),
        truth,
        set_name="hand",
        set_version=1,
        method="ours",
        seed=3,
        index=index,
        seconds=2.5,
    )


def plain_record(
    index: int,
    tips_mm: Sequence[float | None] = (0.1,),
    *,
    right: bool = True,
    status: str = "confident",
    probability: float | None = None,
    method: str = "ours",
    set_name: str = "hand",
    axis_deg: float = 0.1,
    seconds: float = 1.0,
) -> CaseRecord:
    """A record made of figures alone: a screw for each tip error, None for one that is paired wrong."""
    screws = tuple(
        ScrewRecord(
            labels={"AP": f"{number}", "LAT": f"{number}"},
            model="bar",
            outcome="wrong" if tip is None else "right",
            errors=None if tip is None else PoseErrors(tip_mm=tip, center_mm=tip, axis_deg=axis_deg, roll_deg=-tip),
            start=None if tip is None else PoseErrors(tip_mm=10 * tip, center_mm=tip, axis_deg=axis_deg),
        )
        for number, tip in enumerate(tips_mm)
    )
    return CaseRecord(
        set=set_name,
        set_version="1",
        index=index,
        seed=3,
        method=method,
        case=f"case-{index}",
        status=status,  # type: ignore[arg-type]
        pairing_status=status,  # type: ignore[arg-type]
        probability=probability,
        right=right,
        harmless_swap=False,
        pairs_right=sum(tip is not None for tip in tips_mm),
        pairs_answered=len(tips_mm),
        pairs_true=len(tips_mm),
        seconds=seconds,
        screws=screws,
    )


def write_files(folder: Path, truth: TruthFile) -> Path:
    """The case of a truth as files: X-rays with dark bars in grey noise, without parts; returns case.json's path."""
    from screwpose.files.atomic import write_bytes, write_json
    from screwpose.files.schema import AnnotationFile, CaseFile, ModelFile, ViewFile, as_matrix3x4
    from screwpose.images.encoding import encode_png
    from screwpose.implants.mesh import write_stl
    from screwpose.projection.opencv import silhouette

    folder.mkdir(parents=True)
    case = case_of(truth)
    write_stl(BAR.mesh, folder / "bar.stl")
    views = {}
    for name, view in case.views.items():
        grey = np.random.default_rng(len(name)).normal(160, 12, (SIZE, SIZE))
        for screw in truth.screws:
            vertices = rigid.transform(np.array(screw.world_from_cad), BAR.mesh.vertices_mm)
            grey[silhouette(view.camera.project(vertices), BAR.mesh.faces, (SIZE, SIZE))] = 25
        write_bytes(folder / f"{name}.png", encode_png(np.clip(grey, 0, 255).astype(np.uint8)))
        projection = as_matrix3x4(view.camera.projection)
        views[name] = ViewFile(image=f"{name}.png", projection=projection, polarity="metal-dark")
    annotations = {
        name: tuple(
            AnnotationFile(label=one.label, tip=tuple(one.tip_px.tolist()), center=tuple(one.center_px.tolist()))
            for one in marks
        )
        for name, marks in case.annotations.items()
    }
    model = ModelFile(mesh="bar.stl", unit="mm", tip=as_point3(BAR.tip_mm), center=as_point3(BAR.center_mm))
    write_json(folder / "truth.json", truth)
    content = CaseFile(
        format="screwpose-case/1", id="by-hand", views=views, models={"bar": model}, annotations=annotations
    )
    return write_json(folder / "case.json", content)
