"""The options that several commands have, and what the solver makes of them."""

from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Any

import typer

from screwpose.errors import InputError

_LEAST_FACES = 20


class MethodName(StrEnum):
    """How the pairing is decided."""

    default = "default"
    paper = "paper"
    epipolar = "epipolar"


class EngineName(StrEnum):
    """How masks are drawn."""

    auto = "auto"
    opencv = "opencv"
    bitrows = "bitrows"


class RefinementName(StrEnum):
    """How screws are registered."""

    auto = "auto"
    evolution = "evolution"
    thickness = "thickness"


class CamerasName(StrEnum):
    """Whether cameras are refined with the poses."""

    off = "off"
    given = "given"
    auto = "auto"


AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object, for machines.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Print nothing but errors.")]
MethodOption = Annotated[
    MethodName,
    typer.Option(
        help="How the pairing is decided: by the landmarks and the CAD, as in the paper, or by epipolar lines."
    ),
]
EngineOption = Annotated[
    EngineName,
    typer.Option(
        "--engine", help="How masks are drawn: triangle by triangle as in the paper, or as bit rows; auto: by --method."
    ),
]
RefinementOption = Annotated[
    RefinementName,
    typer.Option(
        "--refinement",
        help="How screws are registered: by the paper's evolution, or by thickness; auto: by --method.",
    ),
]
CamerasOption = Annotated[
    CamerasName,
    typer.Option(
        "--cameras",
        help="Refine the cameras with the poses: never, as the case's sigmas say, or also where it has none.",
    ),
]
Faces = Annotated[int, typer.Option(min=0, help="Triangles a model is reduced to in searches; 0: the CAD as it is.")]
Generations = Annotated[int, typer.Option(min=0, help="Generations of the differential evolution; 0: do not register.")]
Population = Annotated[int, typer.Option(min=1, help="Its population, for each degree of freedom.")]
MaxShift = Annotated[
    float, typer.Option(min=0.01, max=100, help="How far the search may move a screw along each axis, mm.")
]
MaxTilt = Annotated[float, typer.Option(min=0.01, max=90, help="How far it may tilt it, degrees.")]
MaxRoll = Annotated[float, typer.Option(min=0.01, max=180, help="How far it may turn it about its axis, degrees.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same answer.")]
ImageSize = Annotated[int, typer.Option(min=128, max=4096, help="Width and height of the images, px.")]
SigmaPx = Annotated[
    float, typer.Option(min=0.01, max=1000, help="How exactly landmarks were marked, px (standard deviation).")
]


def check_faces(faces: int) -> None:
    """Whether a model of so many triangles is any use; 0 is the CAD as it is.

    Raises
    ------
    InputError
        It is not.
    """
    if 0 < faces < _LEAST_FACES:
        raise InputError(
            f"a model of {faces} triangles is no screw",
            field="--faces",
            expected=f"{_LEAST_FACES} or more, or 0 for all",
        )


def chosen(option: EngineName | RefinementName) -> Any:
    """The option's value; None where the method decides."""
    return None if option.value == "auto" else option.value


def solver_options(
    method: MethodName,
    faces: int,
    generations: int,
    population: int,
    seed: int,
    landmark_sigma: float,
    bounds: tuple[float, float, float],
    engine: EngineName = EngineName.auto,
    refinement: RefinementName = RefinementName.auto,
    cameras: CamerasName = CamerasName.given,
) -> Any:
    """`SolveOptions` from what the command line says; `bounds` are shift, tilt and roll."""
    from screwpose.pairing.segment import LandmarkNoise
    from screwpose.solve import SolveOptions

    check_faces(faces)
    options = SolveOptions(
        method=method.value,
        faces=faces or None,
        noise=LandmarkNoise(sigma_px=landmark_sigma),
        engine=chosen(engine),
        refinement=chosen(refinement),
        cameras=cameras.value,
    )
    shift, tilt, roll = bounds
    search = replace(
        options.search,
        generations=generations,
        population=population,
        seed=seed,
        max_shift_mm=shift,
        max_tilt_deg=tilt,
        max_roll_deg=roll,
    )
    return replace(options, search=search)
