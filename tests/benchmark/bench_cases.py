"""Small cases of a user's own for tests of the runner, and records without what differs from run to run."""

import json
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np

from screwpose.files.atomic import write_json
from screwpose.files.schema import AnnotationFile, CaseFile, ModelFile, ViewFile, as_matrix3x4, as_point3
from screwpose.files.truth import write_truth
from screwpose.implants.mesh import write_stl
from tests.benchmark.worked import BAR, SIZE, case_of, truth_of


def write_own_cases(folder: Path, count: int) -> Path:
    """The case that is worked by hand, over grey noise, in ``case-0`` and so on."""
    for index in range(count):
        write_own_case(folder / f"case-{index}")
    return folder


def write_own_case(folder: Path) -> None:
    case = case_of()
    folder.mkdir(parents=True)
    write_stl(BAR.mesh, folder / "bar.stl")
    rng = np.random.default_rng(len(folder.name))
    annotations = {}
    for name in case.views:
        grey = rng.integers(100, 200, (SIZE, SIZE), dtype=np.uint8)
        (folder / f"{name}.png").write_bytes(imagecodecs.png_encode(grey))
        annotations[name] = tuple(
            AnnotationFile(label=mark.label, tip=tuple(mark.tip_px.tolist()), center=tuple(mark.center_px.tolist()))
            for mark in case.annotations[name]
        )
    tip, center = as_point3(BAR.tip_mm), as_point3(BAR.center_mm)
    content = CaseFile(
        format="screwpose-case/1",
        id=folder.name,
        views={
            name: ViewFile(
                image=f"{name}.png", projection=as_matrix3x4(view.camera.projection), polarity="metal-bright"
            )
            for name, view in case.views.items()
        },
        models={"bar": ModelFile(mesh="bar.stl", unit="mm", tip=tip, center=center)},
        annotations=annotations,
    )
    write_json(folder / "case.json", content)
    write_truth(folder / "truth.json", truth_of().model_copy(update={"case": folder.name}))


def records_in(folder: Path) -> dict[str, str]:
    """The text of each record by its path, without the seconds."""
    return {
        path.relative_to(folder).as_posix(): json.dumps(_without_times(json.loads(path.read_text())), sort_keys=True)
        for path in sorted(folder.glob("records/*/*.json"))
    }


def _without_times(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _without_times(value) for key, value in data.items() if key not in ("seconds", "timing_s")}
    return [_without_times(one) for one in data] if isinstance(data, list) else data
