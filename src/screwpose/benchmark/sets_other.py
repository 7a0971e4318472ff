"""The set `other`: implants and patients that nothing was made or tuned with. Held out: for judging alone.

Screws are those of a planning program (meshes that are not closed, without towers); patients are a spine segmented from
a CT, and a CT itself.
"""

import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from screwpose.benchmark.sets_base import BenchmarkSet, case_seed
from screwpose.benchmark.sets_real import data_folder
from screwpose.errors import CaseError
from screwpose.implants.model import Implant
from screwpose.simulation.imperfections import Imperfections
from screwpose.simulation.scenes_options import SceneOptions

if TYPE_CHECKING:
    from screwpose.simulation.scenes import PatientBuilder, ScenePlan

_NAME, _VERSION = "other", 1
_SCREWS, _SPINE, _CT = "screws_lassoan/models.json", "anatomy/P001/vertebrae.json", "ct/example_ct.nii.gz"
_OPTIONS = SceneOptions(
    tower=0.0,
    convergence_deg=(5.0, 30.0),
    angle_deg=(70.0, 110.0),
    overlap_lat=(0.0, 1.0),
    models_named="AP",
)


def other_folder() -> Path:
    """The data folder, with all that the set needs in it.

    Raises
    ------
    CaseError
        ``$SCREWPOSE_DATA`` is not set, or a part of the data is not there.
    """
    folder = data_folder(_NAME, "other people's screws and spines", _SCREWS)
    for part in (_SCREWS, _SPINE, _CT):
        if not (folder / part).is_file():
            raise CaseError(
                "this part of the data is not here",
                file=folder / part,
                expected=f"the data of the set `{_NAME}`",
                remedy="Set SCREWPOSE_DATA to the folder that holds screws_lassoan, anatomy and ct.",
            )
    return folder


def plan_other(seed: int, index: int) -> "ScenePlan":
    """What a case is, without X-raying it. Even cases have the segmented spine, odd ones the CT."""
    from screwpose.simulation.scenes import plan_scene

    folder = other_folder()
    own = case_seed(_NAME, seed, index)
    rng = np.random.default_rng(own)
    names = sorted(json.loads((folder / _SCREWS).read_text(encoding="utf-8"))["models"])
    # Two of one design as often as not.
    first, second = (str(name) for name in rng.choice(names, 2))
    chosen = [first, first if rng.random() < 0.5 else second]
    imperfections = Imperfections(landmark_noise_px=round(float(rng.uniform(0.5, 3.0)), 3))
    return plan_scene(
        _OPTIONS,
        imperfections,
        own,
        case_id=f"{_NAME}-{seed}-{index:04d}",
        patient=_patient(folder, index),
        designs=[screw_of(folder, name) for name in chosen],
    )


@cache
def screw_of(folder: Path, name: str) -> Implant:
    """One of the screws, with its landmarks as they were measured: the tip, and the middle of the shank."""
    from screwpose.implants.mesh import read_mesh

    entry = json.loads((folder / _SCREWS).read_text(encoding="utf-8"))["models"][name]
    mesh = read_mesh((folder / _SCREWS).with_name(name))
    return Implant(Path(name).stem, mesh, np.array(entry["tip"]), np.array(entry["shank_center"]))


def _patient(folder: Path, index: int) -> "PatientBuilder":
    from screwpose.simulation import patient

    if index % 2:
        return lambda rng: patient.ct_patient(folder / _CT, rng)
    return lambda rng: patient.mesh_spine_patient((folder / _SPINE).parent, rng)


def _make_other(seed: int, index: int, folder: Path) -> Path:
    from screwpose.simulation.scenes import xrayed
    from screwpose.simulation.writing import write_case

    asked = {"set": _NAME, "set_version": _VERSION, "set_seed": seed, "index": index}
    return write_case(xrayed(plan_other(seed, index)), folder, asked)


OTHER = BenchmarkSet(
    name=_NAME,
    version=_VERSION,
    make=_make_other,
    size=100,
    origin="simulated, with other people's screws and spines",
    description="held out: two screws of a planning program without towers, in a segmented spine or a CT, views 70 to "
    "110 degrees apart, marks with 0.5 to 3 px of noise",
)
