"""The set `real`: biplane fluoroscopy of a knee implant, whose pose an expert has found."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark.sets_base import BenchmarkSet, case_seed
from screwpose.errors import CaseError
from screwpose.files.atomic import atomic_folder, write_json
from screwpose.files.schema import (
    AnnotationFile,
    CaseFile,
    ModelFile,
    TruthFile,
    TruthScrew,
    ViewFile,
    as_matrix3x4,
    as_point3,
    as_pose,
)
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Mesh

_REAL_NOISE_PX = 2.0


def landmarks_of_no_screw(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Two points that stand in for tip and centre on an implant that is no screw, (3,) each, in the CAD frame.

    The centre is the middle of its bounding box; the tip is the vertex furthest from it.
    """
    center_mm = (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0)) / 2
    distances = np.linalg.norm(mesh.vertices_mm - center_mm, axis=1)
    return mesh.vertices_mm[int(np.argmax(distances))], center_mm


def _make_real(seed: int, index: int, folder: Path) -> Path:
    """One pair of the real biplane study: a femoral implant whose pose an expert has found."""
    from screwpose.implants.mesh import read_mesh
    from screwpose.simulation.scenes_record import SCENE_FILE

    source = biplane_folder()
    pair = _biplane_pairs(source)[index]
    mesh = read_mesh(source / "femur0.stl")
    tip_mm, center_mm = landmarks_of_no_screw(mesh)
    pose = np.array(pair["femur_world_from_cad"])
    rng = np.random.default_rng(case_seed("real", seed, index))
    views, annotations = {}, {}
    with atomic_folder(folder, marker=SCENE_FILE) as partial:
        asked = {"set": "real", "set_version": REAL.version, "set_seed": seed, "index": index}
        write_json(partial / SCENE_FILE, asked)
        shutil.copyfile(source / "femur0.stl", partial / "femur0.stl")
        for name, view in pair["views"].items():
            image = Path(view["image"])
            shutil.copyfile(source / image, partial / image.name)
            camera = Camera.from_matrix(np.array(view["projection"]))
            marks = camera.project(rigid.transform(pose, np.vstack([tip_mm, center_mm])))
            (u_tip, v_tip), (u_center, v_center) = (marks + rng.normal(0.0, _REAL_NOISE_PX, (2, 2))).tolist()
            views[name] = ViewFile(image=image.name, projection=as_matrix3x4(camera.projection), polarity="metal-dark")
            annotations[name] = (AnnotationFile(label="femur", tip=(u_tip, v_tip), center=(u_center, v_center)),)
        case_id = f"biplane-{pair['pair']}"
        model = ModelFile(mesh="femur0.stl", unit="mm", tip=as_point3(tip_mm), center=as_point3(center_mm))
        truth = TruthScrew(labels=dict.fromkeys(views, "femur"), model="femur", world_from_cad=as_pose(pose))
        write_json(partial / "truth.json", TruthFile(format="screwpose-truth/1", case=case_id, screws=(truth,)))
        case = CaseFile(
            format="screwpose-case/1", id=case_id, views=views, models={"femur": model}, annotations=annotations
        )
        write_json(partial / "case.json", case)
    return folder / "case.json"


def data_folder(set_name: str, what: str, holds: str) -> Path:
    """The data folder, ``$SCREWPOSE_DATA``.

    Raises
    ------
    CaseError
        The variable is not set; names the set, what it needs and the file it is known by.
    """
    named = os.environ.get("SCREWPOSE_DATA")
    if not named:
        raise CaseError(
            f"the set `{set_name}` needs {what}, and SCREWPOSE_DATA is not set",
            expected=f"the folder that holds {holds}",
            remedy="Set SCREWPOSE_DATA to it; docs/benchmarks.md says where the data comes from.",
        )
    return Path(named)


def biplane_folder() -> Path:
    """The folder of the real biplane pairs, below ``$SCREWPOSE_DATA``.

    Raises
    ------
    CaseError
        The variable is not set, or there is no such data.
    """
    folder = data_folder("real", "the biplane pairs", "jtml_biplane/cases.json") / "jtml_biplane"
    if not (folder / "cases.json").is_file():
        raise CaseError(
            "there are no biplane pairs here",
            file=folder / "cases.json",
            expected="the data of the set `real`",
            remedy="Set SCREWPOSE_DATA to the folder that holds jtml_biplane.",
        )
    return folder


def _biplane_pairs(folder: Path) -> list[dict[str, Any]]:
    pairs: list[dict[str, Any]] = json.loads((folder / "cases.json").read_text(encoding="utf-8"))["cases"]
    return pairs


REAL = BenchmarkSet(
    name="real",
    version=1,
    make=_make_real,
    size=16,
    origin="an expert's pose, good to some tenths of a mm and of a degree",
    description=f"real biplane fluoroscopy of a knee implant, landmarks with {_REAL_NOISE_PX} px of noise",
)
