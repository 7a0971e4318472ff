"""A simulated case as files, in the project's case format."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from screwpose.files.atomic import atomic_folder, write_bytes, write_json
from screwpose.files.schema import (
    AnnotationFile,
    CaseFile,
    ModelFile,
    PartFile,
    TruthFile,
    TruthScrew,
    ViewFile,
    as_matrix3x4,
    as_point3,
    as_pose,
)
from screwpose.images.encoding import encode_png
from screwpose.implants.mesh import write_stl
from screwpose.implants.model import Implant
from screwpose.simulation.scenes import SimulatedCase
from screwpose.simulation.scenes_record import SCENE_FILE, scene_record

_NEEDLES_WORDS = (
    "Each acquisition repeats the X-rays of the case with a needle along the tower of one screw. Where it is in "
    "both views, there is that screw: so the pairing is known without the truth. folder: where the images of an "
    "acquisition are; labels: the names that the screw has in case.json."
)


def write_case(simulated: SimulatedCase, folder: str | Path, more: Mapping[str, Any] | None = None) -> Path:
    """Write case.json, the X-rays, the models, truth.json and scene.json into a folder, all at once.

    With needle acquisitions there are ``needles/<label>/ap.png`` and ``lat.png``, and ``needles.json`` that says which
    screw each of them is of.

    Parameters
    ----------
    more : goes into scene.json beside what was drawn, as the set that the case belongs to.

    Returns
    -------
    The path of case.json.

    Raises
    ------
    OutputError
        The folder cannot be written, or holds something that is no case.
    """
    with atomic_folder(folder, marker=SCENE_FILE) as partial:
        (partial / "models").mkdir()
        for name, implant in simulated.implants.items():
            write_stl(implant.mesh, partial / "models" / f"{name}.stl")
            for part in _parts(implant):
                write_stl(part.mesh, partial / _part_path(implant, part.name))
        for name, view in simulated.views.items():
            write_bytes(partial / _image_name(name), encode_png(view.xray.pixels))
        if simulated.needles:
            _write_needles(simulated, partial)
        write_json(partial / SCENE_FILE, {**(more or {}), **scene_record(simulated.plan)})
        write_json(partial / "truth.json", truth_file(simulated))
        write_json(partial / "case.json", case_file(simulated))
    return Path(folder) / "case.json"


def _image_name(view: str) -> str:
    return f"{view.lower()}.png"


def _parts(implant: Implant) -> tuple[Any, ...]:
    """Those that can move: a rigid implant has none worth a file."""
    return implant.parts if implant.pivot_mm is not None else ()


def _part_path(implant: Implant, part: str) -> str:
    return f"models/{implant.name}-{part}.stl"


def _write_needles(simulated: SimulatedCase, folder: Path) -> None:
    acquisitions = []
    for name, acquisition in simulated.needles.items():
        place = Path("needles") / name
        (folder / place).mkdir(parents=True)
        for view, xray in acquisition.xrays.items():
            write_bytes(folder / place / _image_name(view), encode_png(xray.pixels))
        labels = dict(simulated.screws[acquisition.screw].labels)
        acquisitions.append({"folder": place.as_posix(), "labels": labels})
    write_json(folder / "needles.json", {"about": _NEEDLES_WORDS, "acquisitions": acquisitions})


def case_file(simulated: SimulatedCase) -> CaseFile:
    """case.json's content."""
    metal = "metal-dark" if simulated.plan.detector.metal_dark else "metal-bright"
    return CaseFile(
        format="screwpose-case/1",
        id=simulated.id,
        views={
            name: ViewFile(
                image=_image_name(name),
                projection=as_matrix3x4(view.camera.projection),
                polarity=metal,
                mask=None,
                target=None,
            )
            for name, view in simulated.views.items()
        },
        models={name: _model_file(implant) for name, implant in simulated.implants.items()},
        annotations={
            name: tuple(
                AnnotationFile(
                    label=mark.label,
                    tip=(float(mark.tip_px[0]), float(mark.tip_px[1])),
                    center=(float(mark.center_px[0]), float(mark.center_px[1])),
                    model=mark.model,
                )
                for mark in marks
            )
            for name, marks in simulated.annotations.items()
        },
    )


def _model_file(implant: Implant) -> ModelFile:
    parts = tuple(PartFile(name=part.name, mesh=_part_path(implant, part.name)) for part in _parts(implant))
    return ModelFile(
        mesh=f"models/{implant.name}.stl",
        unit="mm",
        tip=as_point3(implant.tip_mm),
        center=as_point3(implant.center_mm),
        parts=parts or None,
        pivot=None if implant.pivot_mm is None else as_point3(implant.pivot_mm),
    )


def truth_file(simulated: SimulatedCase) -> TruthFile:
    """truth.json's content."""
    return TruthFile(
        format="screwpose-truth/1",
        case=simulated.id,
        screws=tuple(
            TruthScrew(
                labels=dict(screw.labels),
                model=screw.model,
                world_from_cad=as_pose(screw.world_from_cad),
                parts={name: as_pose(pose) for name, pose in parts.items()} or None,
            )
            for screw, parts in zip(simulated.screws, simulated.parts, strict=True)
        ),
    )
