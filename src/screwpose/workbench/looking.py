"""What the page shows of a case before it is solved: its X-rays, what is wrong, which marks may be one screw."""

import hashlib
import json
from collections.abc import Callable, Mapping
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.errors import CalibrationError, InputError, ScrewposeError
from screwpose.files.case import Case
from screwpose.files.findings import Finding
from screwpose.geometry import Camera, fundamental_matrix, rigid

Tell = Callable[[float, str], None]

# As `screwpose check` assumes.
_SIGMA_PX = 2.0
_TEXTURE_SIDE_PX = 1024
_TOLERANCE_PX = 0.7  # of a mask's border on the screen
_SUGGESTED = 6


def look(tell: Tell, folder: str, cache: str) -> dict[str, Any]:
    """Everything about a case that can be known before solving.

    Returns
    -------
    ``views``: by name size, the key of the pixels in the cache, what does not count; ``epipolar``: F (3, 3) from each
    view to each other; ``findings``; ``pairs``: the likeliest pairing so far, with its landmarks projected back.
    """
    from screwpose.files.inspection import Inspection, objects_in
    from screwpose.files.schema import ViewFile
    from screwpose.files.strict_json import read_json
    from screwpose.jobs import checked_case

    file = Path(folder) / "case.json"
    entries = objects_in(read_json(file).get("views"), ViewFile)
    views = {}
    for index, (name, entry) in enumerate(entries.items()):
        tell(0.1 + 0.4 * index / len(entries), f"reading {name}")
        shown = _view(name, entry, Inspection(file), Path(cache))
        if shown is not None:
            views[name] = shown
    tell(0.6, "checking")
    case, findings = checked_case(folder, _SIGMA_PX)
    return {
        "views": views,
        "epipolar": _epipolar({n: e["projection"] for n, e in entries.items() if "projection" in e}),
        "findings": [_told(one) for one in findings],
        "pairs": [] if case is None else _suggested(case),
        "is_ready": case is not None,
    }


def _told(finding: Finding) -> dict[str, str]:
    """A finding by its field, and in a sentence without file and field: it stands beside what it is about."""
    error = finding.as_error()
    error.file = error.field = None
    text = str(error)
    return {"level": finding.level, "field": finding.field or "", "text": text[:1].upper() + text[1:]}


def _view(name: str, entry: Mapping[str, Any], inspection: Any, cache: Path) -> dict[str, Any] | None:
    """The facts of an X-ray, and its pixels written into the cache where they are not there; None if unreadable."""
    from screwpose.errors import ImageError

    path = inspection.file(entry.get("image"), f"views.{name}.image", ImageError)
    if path is None:
        return None
    polarity = entry.get("polarity", "auto")
    mask = inspection.file(entry.get("mask"), f"views.{name}.mask", ImageError)
    key = hashlib.sha256(path.read_bytes() + polarity.encode()).hexdigest()[:32]
    try:
        facts: dict[str, Any] = _cached_pixels(path, polarity, key, cache)
        outside = facts["outside"] if mask is None else _outside_of(mask, (facts["width"], facts["height"]))
    except InputError:
        return None  # what is wrong with it stands among the findings
    return {**facts, "outside": outside, "own_mask": mask is not None}


def _cached_pixels(path: Path, polarity: Any, key: str, cache: Path) -> dict[str, Any]:
    from screwpose.files.atomic import write_bytes, write_text
    from screwpose.images import encode_png, field_of_view, read_radiograph

    facts_file = cache / f"{key}.json"
    if facts_file.exists():
        known: dict[str, Any] = json.loads(facts_file.read_text(encoding="utf-8"))
        return known
    radiograph = read_radiograph(path, polarity)
    bright = 1.0 - np.clip(radiograph.pixels, 0.0, 1.0)  # as people are used to it: metal dark
    levels = np.rint(65535.0 * bright).astype("<u2")
    mask = field_of_view(radiograph)
    low, high = np.percentile(levels[mask][::7], [0.2, 99.8])
    write_bytes(cache / f"{key}.u16", levels.tobytes())
    write_bytes(cache / f"{key}.png", encode_png(_small(levels, float(low), float(high))))
    width, height = radiograph.size
    facts = {
        "key": key, "width": width, "height": height, "bits": radiograph.bits,
        "window": [float(low), float(max(high, low + 1.0))], "outside": _outside(mask),
    }  # fmt: skip
    write_text(facts_file, json.dumps(facts))
    return facts


def _small(levels: Any, low: float, high: float) -> Any:
    """A preview of 8 bits, for the start page and the planes in space."""
    import cv2

    scale = _TEXTURE_SIDE_PX / max(levels.shape)
    if scale < 1:
        levels = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    shown = np.clip((levels.astype(np.float32) - low) / max(high - low, 1.0), 0.0, 1.0)
    return np.rint(255 * shown).astype(np.uint8)


def _outside_of(mask: Path, size: tuple[int, int]) -> list[list[float]]:
    from screwpose.images import read_mask

    return _outside(read_mask(mask, size))


def _outside(mask: Any) -> list[list[float]]:
    """The polygons of what does not count, for the even-odd rule; none where all counts."""
    import cv2

    from screwpose.report.shadows import mask_outlines

    if mask.all():
        return []
    simpler = (
        cv2.approxPolyDP(one.astype(np.float32)[:, None], _TOLERANCE_PX, True)[:, 0] for one in mask_outlines(mask)
    )
    return [[round(float(x), 1) for x in one.ravel()] for one in simpler if len(one) >= 3]


def _epipolar(matrices: Mapping[str, Any]) -> dict[str, dict[str, list[list[float]]]]:
    """F by the view that holds the point and the view that holds its line."""
    cameras = {}
    for name, matrix in matrices.items():
        try:
            cameras[name] = Camera.from_matrix(np.array(matrix))
        except CalibrationError:
            continue  # a finding says so
    found: dict[str, dict[str, list[list[float]]]] = {name: {} for name in cameras}
    for first, second in permutations(cameras, 2):
        found[first][second] = fundamental_matrix(cameras[first], cameras[second]).tolist()
    return found


def _suggested(case: Case) -> list[dict[str, Any]]:
    """The likeliest pairing of the marks, each pair with its model's landmarks projected back into the views."""
    from screwpose.pairing.hypotheses import HypothesisTable
    from screwpose.pairing.ranking import ranked_pairings
    from screwpose.pairing.segment import LandmarkNoise
    from screwpose.registration import align

    noise = LandmarkNoise(sigma_px=_SIGMA_PX)
    try:
        ranking = ranked_pairings(case, noise, HypothesisTable(case, noise), _SUGGESTED)
    except ScrewposeError:
        return []
    shown = ranking.shown(1)
    pairs = []
    for hypothesis in shown[0].hypotheses if shown else ():
        implant = case.implants[hypothesis.model]
        pose = align(implant, hypothesis.fit.tip_mm, hypothesis.fit.center_mm)
        points = {}
        for name, _ in hypothesis.labels:
            camera = case.views[name].camera
            ends = (rigid.transform(pose, implant.tip_mm), rigid.transform(pose, implant.center_mm))
            if min(camera.depth_mm(np.array(ends))) > 0:
                points[name] = [camera.project(end).round(2).tolist() for end in ends]
        pairs.append(
            {
                "labels": hypothesis.by_view,
                "model": hypothesis.model,
                "probability": ranking.pair_probability(hypothesis.labels),
                "points": points,
            }
        )
    return pairs
