"""A case of some screws, and the answer to it, made by hand: what the report's tests draw."""

from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Annotation, Case, View
from screwpose.files.result import CombinationScene, PosedImplant, Result
from screwpose.files.schema import ResultFile
from screwpose.geometry.camera import Camera
from screwpose.geometry.triangulation import triangulate
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant, Mesh
from screwpose.projection.opencv import silhouette

SOURCE_TO_CENTER_MM = 600.0


def rod(name: str = "rod", sides: int = 12) -> Implant:
    """A closed screw-like body about +y: point at the origin, shank to 45 mm, a wider tower to 120 mm."""
    profile = np.array([[0.0, 0.0], [3.0, 6.0], [3.2, 45.0], [6.0, 47.0], [6.0, 120.0], [0.0, 120.0]])
    angles = 2 * np.pi * np.arange(sides) / sides
    rings = [np.stack([r * np.cos(angles), np.full(sides, y), r * np.sin(angles)], axis=1) for r, y in profile]
    faces = []
    for ring in range(len(profile) - 1):
        a = ring * sides + np.arange(sides)
        b = ring * sides + np.roll(np.arange(sides), -1)
        faces += [np.stack([a, a + sides, b], axis=1), np.stack([b, a + sides, b + sides], axis=1)]
    mesh = Mesh(np.vstack(rings), np.vstack(faces).astype(np.int64))
    return Implant(name, mesh, np.zeros(3), np.array([0.0, 22.5, 0.0]))


def camera(direction: FloatArray, size: tuple[int, int], field_mm: float = 190.0) -> Camera:
    """A source SOURCE_TO_CENTER_MM from the world's origin looking along `direction`; +z is up in the image."""
    away = direction / np.linalg.norm(direction)
    down = np.array([0.0, 0.0, -1.0])
    right = np.cross(down, away)
    rotation = np.stack([right, down, away])
    focal = SOURCE_TO_CENTER_MM * size[0] / field_mm
    k = np.array([[focal, 0.0, (size[0] - 1) / 2], [0.0, focal, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])
    translation = -rotation @ (-SOURCE_TO_CENTER_MM * away)
    return Camera.from_matrix(k @ np.column_stack([rotation, translation]), size)


def pose(tip: FloatArray, center: FloatArray) -> FloatArray:
    """world_from_cad (4, 4) that lays the tip on `tip` and the axis +y on the direction to `center`."""
    y = (center - tip) / np.linalg.norm(center - tip)
    x = np.cross(y, [0.31, 0.2, 0.93])
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([x, y, np.cross(x, y)])
    matrix[:3, 3] = tip
    return matrix


def true_poses(screws: int) -> list[FloatArray]:
    """Screws at alternating sides of a spine along z, heads towards the AP source."""
    poses = []
    for index in range(screws):
        side = -1.0 if index % 2 == 0 else 1.0
        height = 38.0 * (index // 2) - 19.0 * ((screws - 1) // 2) + 3.0 * side
        tip = np.array([10.0 * side, 20.0, height])
        poses.append(pose(tip, tip + np.array([6.0 * side, -22.0, 1.0 + 2.0 * index])))
    return poses


def make_case(
    size: tuple[int, int] = (160, 120), screws: int = 2, implant: Implant | None = None, noise_px: float = 1.0
) -> tuple[Case, list[PosedImplant]]:
    """A case with views AP and LAT and the true poses; screw i is ``str(i + 1)`` in AP and the i-th letter in LAT."""
    implant = implant or rod()
    rng = np.random.default_rng(7)
    cameras = {"AP": camera(np.array([0.0, 1.0, 0.0]), size), "LAT": camera(np.array([1.0, 0.06, 0.0]), size)}
    truth = [
        PosedImplant({"AP": str(index + 1), "LAT": chr(ord("a") + index)}, implant.name, matrix)
        for index, matrix in enumerate(true_poses(screws))
    ]
    views, annotations = {}, {}
    for name, one in cameras.items():
        v, u = np.mgrid[: size[1], : size[0]]
        pixels = 0.35 + 0.15 * np.cos(u / size[0] * 3) + 0.1 * np.sin(v / size[1] * 9) + rng.normal(0, 0.02, v.shape)
        marks = []
        for posed in truth:
            vertices = implant.mesh.vertices_mm @ posed.world_from_cad[:3, :3].T + posed.world_from_cad[:3, 3]
            pixels = pixels + 0.3 * silhouette(one.project(vertices), implant.mesh.faces, (size[1], size[0]))
            landmarks = np.array([implant.tip_mm, implant.center_mm])
            in_world = landmarks @ posed.world_from_cad[:3, :3].T + posed.world_from_cad[:3, 3]
            tip_px, center_px = one.project(in_world) + rng.normal(0, noise_px, (2, 2))
            marks.append(Annotation(posed.labels[name], tip_px, center_px, implant.name))
        radiograph = Radiograph(np.clip(pixels, 0, 1).astype(np.float32))
        views[name] = View(name, one, radiograph, np.ones((size[1], size[0]), dtype=np.bool_))
        annotations[name] = tuple(marks)
    return Case(
        "phantom-007", views, {implant.name: implant}, annotations, warnings=("AP: read as metal-dark.",)
    ), truth


def from_landmarks(case: Case, pairs: dict[str, str]) -> PosedImplant:
    """A screw laid on its triangulated landmarks, as before registration."""
    implant = next(iter(case.implants.values()))
    marks = {view: next(m for m in case.annotations[view] if m.label == label) for view, label in pairs.items()}
    cameras = [case.views[view].camera for view in pairs]
    tip = triangulate(cameras, np.array([mark.tip_px for mark in marks.values()])).point_in_world_mm
    center = triangulate(cameras, np.array([mark.center_px for mark in marks.values()])).point_in_world_mm
    return PosedImplant(pairs, implant.name, pose(tip, center))


def _scores(dice: float, loss: float) -> dict[str, Any]:
    return {
        "dice": dice,
        "loss": loss,
        "views": {"AP": {"dice": dice + 0.01, "loss": loss - 0.06}, "LAT": {"dice": dice - 0.01, "loss": loss + 0.06}},
    }


def combinations_of(case: Case, count: int) -> list[list[dict[str, str]]]:
    """The true pairing first, then pairings whose LAT labels are turned by one, two, ... places."""
    first = [mark.label for mark in case.annotations["AP"]]
    second = [mark.label for mark in case.annotations["LAT"]]
    return [[{"AP": a, "LAT": second[(i + turn) % len(second)]} for i, a in enumerate(first)] for turn in range(count)]


def make_result(case: Case, truth: list[PosedImplant], combinations: int = 2, **changes: Any) -> Result:
    """A confident answer with the right pairing; `changes` replace keys of the result file."""
    implant = next(iter(case.implants.values()))
    pairings = combinations_of(case, combinations)
    scenes = []
    for index, pairs in enumerate(pairings):
        start = tuple(from_landmarks(case, labels) for labels in pairs)
        scenes.append(CombinationScene(index + 1, start, tuple(truth) if index == 0 else start))
    content: dict[str, Any] = {
        "format": "screwpose-result/1",
        "case": case.id,
        "software": {"name": "screwpose", "version": "0.1.0"},
        "status": "confident",
        "pairing": {
            "status": "confident",
            "probability": 0.998,
            "pairs": pairings[0],
            "unpaired": {"AP": [], "LAT": []},
            "chosen_by": {"pre": 1, "post": 1},
        },
        "combinations": [
            {
                "id": index + 1,
                "pairs": pairs,
                "probability": 0.998 if index == 0 else 0.002 / max(1, combinations - 1),
                "pre": _scores(0.86 - 0.25 * (index > 0) - 0.01 * index, -0.24 + 0.18 * (index > 0)),
                "post": _scores(0.91 - 0.2 * (index > 0) - 0.01 * index, -0.35 + 0.2 * (index > 0)),
            }
            for index, pairs in enumerate(pairings)
        ],
        "screws": [
            {
                "labels": dict(posed.labels),
                "model": posed.model,
                "status": "ok",
                "world_from_cad": posed.world_from_cad.tolist(),
                "tip": posed.world_from_cad[:3, 3].tolist(),
                "center": (posed.world_from_cad @ np.append(implant.center_mm, 1.0))[:3].tolist(),
                "axis": (posed.world_from_cad[:3, :3] @ implant.axis).tolist(),
                "sigma": None
                if index
                else {"tip_mm": 0.08, "axis_deg": 0.1, "roll_deg": 0.9, "tip_covariance_mm2": None},
                "scores": {"pre": {"dice": 0.86, "loss": -0.24}, "post": {"dice": 0.91, "loss": -0.35}},
            }
            for index, posed in enumerate(truth)
        ],
        "warnings": [],
        "timing_s": {"load": 0.1, "pairing": 0.2, "registration": 0.6, "total": 0.9},
    }
    return Result(ResultFile.model_validate(content | changes), tuple(scenes))


def make_refused(case: Case) -> Result:
    """An answer that gives none."""
    content = {
        "format": "screwpose-result/1",
        "case": case.id,
        "software": {"name": "screwpose", "version": "0.1.0"},
        "status": "refused",
        "pairing": {
            "status": "refused",
            "pairs": [],
            "unpaired": {name: [m.label for m in marks] for name, marks in case.annotations.items()},
        },
        "combinations": [],
        "screws": [],
        "warnings": ["The marked landmarks fit no pairing: the rays miss each other by 14 mm."],
        "timing_s": {"total": 0.1},
    }
    return Result(ResultFile.model_validate(content), ())
