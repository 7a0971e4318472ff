"""The worst cases of each method, drawn: where the answer lies and where the truth does."""

import base64
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark.measures_blocks import is_confident_wrong
from screwpose.benchmark.record import CaseRecord, ScrewRecord
from screwpose.benchmark.sets import BenchmarkSet
from screwpose.benchmark.strata import posed_meshes
from screwpose.benchmark.tables import result_file
from screwpose.errors import ScrewposeError
from screwpose.files.case import Case, View, read_case
from screwpose.files.result import read_result
from screwpose.files.schema import ScrewResultFile, TruthFile, TruthScrew
from screwpose.files.truth import read_truth
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.report.overlays import Box, display_grey
from screwpose.report.shadows import trace_outlines

WORST = 10
_MARGIN = 0.15
_SMALLEST_PX = 90.0  # a picture of fewer detector pixels shows grain and no anatomy
_SHOWN_PX = 420
_JPEG_QUALITY = 85
_MAX_SCREWS = 4
# A pose this far off is seen in a picture of the whole screw; a smaller error only close to the shank.
_SEEN_FROM_AFAR_MM = 4.0
_MIN_DEPTH_MM = 1.0


@dataclass(frozen=True)
class Picture:
    """A part of one view: the X-ray as a data URI in its box, and outlines as SVG paths in the view's pixels."""

    view: str
    image: str
    box: Box
    answered: tuple[str, ...]
    true: tuple[str, ...]


@dataclass(frozen=True)
class WorstCase:
    """One case in the list of the worst; without pictures and with a `problem` where it could not be drawn."""

    record: CaseRecord
    verdict: str
    numbers: str
    pictures: tuple[Picture, ...] = ()
    problem: str | None = None


def worst_records(records: Iterable[CaseRecord], count: int = WORST) -> list[CaseRecord]:
    """The worst answered cases of one method: sure and wrong first, then wrong, then by the largest tip error.

    Refused cases have no answer to look at; the page lists them with their reasons.
    """
    answered = [one for one in records if one.error is None and one.status != "refused"]
    return sorted(answered, key=_badness, reverse=True)[:count]


def _badness(record: CaseRecord) -> tuple[bool, bool, float, float, int]:
    errors = [screw.errors for screw in record.screws if screw.errors is not None]
    tip = max((one.tip_mm for one in errors), default=0.0)
    axis = max((one.axis_deg for one in errors), default=0.0)
    return is_confident_wrong(record), not (record.right or record.harmless_swap), tip, axis, -record.index


def draw_worst(
    folder: Path, methods: Mapping[str, Sequence[CaseRecord]], sets: Mapping[str, BenchmarkSet], count: int = WORST
) -> dict[str, list[WorstCase]]:
    """The worst cases by method, over all sets.

    Parameters
    ----------
    folder : of the run: results, and cases where they were kept. A case that was not is made again from its seed.
    methods : all records by method.
    """
    chosen = {method: worst_records(records, count) for method, records in methods.items()}
    drawn: dict[tuple[str, str, int], WorstCase] = {}
    by_case: dict[tuple[str, int], list[CaseRecord]] = {}
    for records in chosen.values():
        for record in records:
            by_case.setdefault((record.set, record.index), []).append(record)
    for same in by_case.values():
        for record, worst in zip(same, _drawn(folder, same, sets), strict=True):
            drawn[record.method, record.set, record.index] = worst
    return {
        method: [drawn[record.method, record.set, record.index] for record in records]
        for method, records in chosen.items()
    }


def _drawn(folder: Path, records: Sequence[CaseRecord], sets: Mapping[str, BenchmarkSet]) -> Iterator[WorstCase]:
    """The answers of several methods to one case."""
    with TemporaryDirectory(prefix="screwpose-worst-") as scratch:
        try:
            path = _case_path(folder, records[0], sets, Path(scratch))
            case, truth = read_case(path), read_truth(path.parent)
        except Exception as error:  # noqa: BLE001  hours of results must not go without a page for one picture
            for record in records:
                yield WorstCase(record, _verdict(record), _numbers(record), problem=_told(error))
            return
        for record in records:
            try:
                screws = read_result(result_file(folder, record)).screws
                pictures = tuple(_pictures(case, truth, record, screws))
                yield WorstCase(record, _verdict(record), _numbers(record), pictures)
            except Exception as error:  # noqa: BLE001  as above
                yield WorstCase(record, _verdict(record), _numbers(record), problem=_told(error))


def _told(error: Exception) -> str:
    return str(error) if isinstance(error, ScrewposeError) else f"{type(error).__name__}: {error}"


def _case_path(folder: Path, record: CaseRecord, sets: Mapping[str, BenchmarkSet], scratch: Path) -> Path:
    kept = folder / "cases" / f"{record.set}-{record.index:04d}" / "case.json"
    if kept.is_file():
        return kept
    if record.set not in sets:
        raise ScrewposeError(f"the set {record.set!r} is not known here, so its cases cannot be made again")
    return sets[record.set].make(record.seed, record.index, scratch / "case")


def _verdict(record: CaseRecord) -> str:
    if record.right:
        return f"paired right, {record.pairing_status}"
    if record.harmless_swap:
        return f"harmless swap, {record.pairing_status}"
    return f"paired wrong, {record.pairing_status}"


def _numbers(record: CaseRecord) -> str:
    texts = [f"case {record.case}", f"{record.pairs_right} of {record.pairs_true} pairs right"]
    if record.probability is not None:
        texts.append(f"p {record.probability:.3f}")
    for screw in sorted(record.screws, key=_tip_mm, reverse=True)[:_MAX_SCREWS]:
        if screw.errors is not None:
            name = "/".join(screw.labels.values())
            roll = "" if screw.errors.roll_deg is None else f", roll {screw.errors.roll_deg:.1f}°"
            texts.append(f"{name}: tip {screw.errors.tip_mm:.2f} mm, axis {screw.errors.axis_deg:.2f}°{roll}")
    if record.strata is not None:
        texts.append(f"overlap {', '.join(f'{view} {share:.0%}' for view, share in record.strata.overlap.items())}")
        if record.strata.epipolar_ambiguity_px is not None:
            texts.append(f"epipolar ambiguity {record.strata.epipolar_ambiguity_px:.1f} px")
        if record.strata.landmark_noise_px is not None:
            texts.append(f"landmark noise {record.strata.landmark_noise_px:.1f} px")
    return "; ".join(texts)


def _pictures(
    case: Case, truth: TruthFile, record: CaseRecord, answered: Sequence[ScrewResultFile]
) -> Iterator[Picture]:
    shown = _indices_to_show(record)
    true = [truth.screws[index] for index in shown]
    labels = {item for screw in true for item in screw.labels.items()}
    mine = [screw for screw in answered if labels & set(screw.labels.items())][: 2 * _MAX_SCREWS]
    is_close = record.right and all(
        screw.errors is not None and screw.errors.tip_mm < _SEEN_FROM_AFAR_MM
        for screw in (record.screws[index] for index in shown)
    )
    for view in case.views.values():
        box = _box(view, case.implants, true, mine, is_close)
        yield Picture(
            view.name,
            _crop(view, box),
            box,
            tuple(_path(view, _answered_meshes(one, case.implants[one.model])) for one in mine),
            tuple(_path(view, posed_meshes(one, case.implants[one.model])) for one in true),
        )


def _indices_to_show(record: CaseRecord) -> list[int]:
    """The screws that make the case one of the worst: all that are not right, else the one that is furthest off."""
    if not record.right:
        return [index for index, one in enumerate(record.screws) if one.outcome != "right"][:_MAX_SCREWS]
    return [max(range(len(record.screws)), key=lambda index: _tip_mm(record.screws[index]))]


def _tip_mm(screw: ScrewRecord) -> float:
    return -1.0 if screw.errors is None else screw.errors.tip_mm


def _answered_meshes(screw: ScrewResultFile, implant: Implant) -> list[tuple[Mesh, FloatArray]]:
    posed = {name: np.array(part.world_from_cad) for name, part in (screw.parts or {}).items()}
    if implant.parts and all(part.name in posed for part in implant.parts):
        return [(part.mesh, posed[part.name]) for part in implant.parts]
    return [(implant.mesh, np.array(screw.world_from_cad))]


def _box(
    view: View,
    implants: Mapping[str, Implant],
    true: Sequence[TruthScrew],
    answered: Sequence[ScrewResultFile],
    is_close: bool,
) -> Box:
    """The shank alone where the poses nearly agree, else the whole of the screws."""
    points = []
    screws: list[TruthScrew | ScrewResultFile] = [*true, *answered]
    for screw in screws:
        implant = implants[screw.model]
        beyond = 2.0 * implant.center_mm - implant.tip_mm
        local = np.array([implant.tip_mm, beyond]) if is_close else implant.mesh.vertices_mm
        world = rigid.transform(np.array(screw.world_from_cad), local)
        if view.camera.depth_mm(world).min() > _MIN_DEPTH_MM:
            points.append(view.camera.project(world))
    width, height = view.radiograph.size
    if not points:
        return Box(0, 0, width - 1, height - 1)
    stacked = np.clip(np.vstack(points), 0, [width - 1, height - 1])
    low, high = stacked.min(axis=0), stacked.max(axis=0)
    middle = 0.5 * (low + high)
    half = np.maximum(0.5 * (high - low) + _MARGIN * float((high - low).max()), 0.5 * _SMALLEST_PX)
    half = np.maximum(half, 0.4 * half.max())  # no slivers
    left, top = np.maximum(np.floor(middle - half), 0).astype(int)
    right, bottom = np.minimum(np.ceil(middle + half), [width - 1, height - 1]).astype(int)
    return Box(int(left), int(top), int(right), int(bottom))


def _path(view: View, posed: Sequence[tuple[Mesh, FloatArray]]) -> str:
    """Outlines as one SVG path; what reaches behind the source lands nowhere and is left out."""
    rows, columns = view.radiograph.pixels.shape
    texts = []
    for mesh, world_from_cad in posed:
        vertices = rigid.transform(world_from_cad, mesh.vertices_mm)
        if view.camera.depth_mm(vertices).min() > _MIN_DEPTH_MM:
            outlines = trace_outlines(view.camera.project(vertices), mesh.faces, (rows, columns))
            texts += [f"M{' '.join(f'{u:.1f},{v:.1f}' for u, v in outline)}Z" for outline in outlines]
    return "".join(texts)


def _crop(view: View, box: Box) -> str:
    """The part of the X-ray as a JPEG: its noise would make a lossless picture several times as large."""
    import cv2

    grey = display_grey(view)[box.top : box.bottom + 1, box.left : box.right + 1]
    scale = _SHOWN_PX / max(grey.shape)
    if scale < 1.0:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, encoded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(encoded.tobytes()).decode()}"
