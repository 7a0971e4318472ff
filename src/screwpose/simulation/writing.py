"""A simulated case as files, in the project's case format."""

from pathlib import Path

from screwpose.files.atomic import atomic_folder, write_bytes, write_json
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
from screwpose.images.encoding import encode_png
from screwpose.implants.mesh import write_stl
from screwpose.simulation.scenes import SimulatedCase


def write_case(simulated: SimulatedCase, folder: str | Path) -> Path:
    """Write case.json, the X-rays, the models and truth.json into a folder, all at once.

    Returns
    -------
    The path of case.json.

    Raises
    ------
    OutputError
        The folder cannot be written, or holds something that is no case.
    """
    # Known by its truth: a folder with a case alone is somebody's own, and must not be replaced.
    with atomic_folder(folder, marker="truth.json") as partial:
        (partial / "models").mkdir()
        for name, implant in simulated.implants.items():
            write_stl(implant.mesh, partial / "models" / f"{name}.stl")
        for name, view in simulated.views.items():
            write_bytes(partial / f"{name.lower()}.png", encode_png(view.xray.pixels))
        write_json(partial / "truth.json", truth_file(simulated))
        write_json(partial / "case.json", case_file(simulated))
    return Path(folder) / "case.json"


def case_file(simulated: SimulatedCase) -> CaseFile:
    """case.json's content."""
    return CaseFile(
        format="screwpose-case/1",
        id=simulated.id,
        views={
            name: ViewFile(
                image=f"{name.lower()}.png",
                projection=as_matrix3x4(view.camera.projection),
                polarity="metal-dark",
                mask=None,
                target=None,
            )
            for name, view in simulated.views.items()
        },
        models={
            name: ModelFile(
                mesh=f"models/{name}.stl",
                unit="mm",
                tip=as_point3(implant.tip_mm),
                center=as_point3(implant.center_mm),
                parts=None,
                pivot=None,
            )
            for name, implant in simulated.implants.items()
        },
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


def truth_file(simulated: SimulatedCase) -> TruthFile:
    """truth.json's content."""
    return TruthFile(
        format="screwpose-truth/1",
        case=simulated.id,
        screws=tuple(
            TruthScrew(
                labels=dict(screw.labels), model=screw.model, world_from_cad=as_pose(screw.world_from_cad), parts=None
            )
            for screw in simulated.screws
        ),
    )
