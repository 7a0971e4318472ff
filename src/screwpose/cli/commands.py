"""The front door: each command parses, calls the library, and prints."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from screwpose import __version__
from screwpose.cli.bench import bench
from screwpose.cli.options import (
    AsJson,
    CamerasName,
    CamerasOption,
    EngineName,
    EngineOption,
    Faces,
    Generations,
    ImageSize,
    MaxRoll,
    MaxShift,
    MaxTilt,
    MethodName,
    MethodOption,
    Population,
    Quiet,
    RefinementName,
    RefinementOption,
    Seed,
    SigmaPx,
    solver_options,
)
from screwpose.cli.terminal import BAD_INPUT, EXIT_CODES, REFUSED, answers_errors, say_json, shown_progress
from screwpose.errors import InputError

app = typer.Typer(
    name="screwpose",
    help="Pair pedicle screws across two calibrated C-arm X-rays and find their 3D poses from CAD models. "
    "Research software: not a medical device.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
model_app = typer.Typer(help="Look at CAD models.", no_args_is_help=True)
app.add_typer(model_app, name="model")


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        typer.echo(f"screwpose {__version__}")
        raise typer.Exit


@app.command()
@answers_errors
def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into.")] = Path("screwpose-demo"),
    seed: Seed = 7,
    size: ImageSize = 1024,
    method: MethodOption = MethodName.default,
    engine: EngineOption = EngineName.auto,
    refinement: RefinementOption = RefinementName.auto,
    cameras: CamerasOption = CamerasName.given,
    faces: Faces = 1000,
    generations: Generations = 60,
    population: Population = 5,
    landmark_sigma: SigmaPx = 2.0,
    max_shift: MaxShift = 2.0,
    max_tilt: MaxTilt = 5.0,
    max_roll: MaxRoll = 15.0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make a case of two screws with known truth, solve it, score it, and write everything."""
    from screwpose.cli.jobs import run_demo
    from screwpose.cli.words import told_demo

    bounds = (max_shift, max_tilt, max_roll)
    options = solver_options(
        method, faces, generations, population, seed, landmark_sigma, bounds, engine, refinement, cameras
    )
    with shown_progress(quiet or as_json) as progress:
        result, comparison = run_demo(out, seed, size, options, progress)
    if as_json:
        say_json({"out": str(out), "result": result.answer.model_dump(mode="json", exclude_none=True)})
    elif not quiet:
        typer.echo(told_demo(out, result.answer, comparison))
    _leave_by(result.answer.status)


@app.command()
@answers_errors
def solve(
    case: Annotated[Path, typer.Argument(help="case.json, or its folder.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into.")],
    method: MethodOption = MethodName.default,
    engine: EngineOption = EngineName.auto,
    refinement: RefinementOption = RefinementName.auto,
    cameras: CamerasOption = CamerasName.given,
    faces: Faces = 1000,
    generations: Generations = 60,
    population: Population = 5,
    seed: Seed = 0,
    landmark_sigma: SigmaPx = 2.0,
    max_shift: MaxShift = 2.0,
    max_tilt: MaxTilt = 5.0,
    max_roll: MaxRoll = 15.0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Pair and register the screws of CASE; write result, overlays, table, meshes and report."""
    from screwpose.cli.jobs import solve_files
    from screwpose.cli.words import told_result

    bounds = (max_shift, max_tilt, max_roll)
    options = solver_options(
        method, faces, generations, population, seed, landmark_sigma, bounds, engine, refinement, cameras
    )
    with shown_progress(quiet or as_json) as progress:
        result, _ = solve_files(case, out, options, progress)
    if as_json:
        say_json({"out": str(out), "result": result.answer.model_dump(mode="json", exclude_none=True)})
    elif not quiet:
        typer.echo(told_result(out, result.answer))
    _leave_by(result.answer.status)


@app.command()
@answers_errors
def check(
    case: Annotated[Path, typer.Argument(help="case.json, or its folder.")],
    landmark_sigma: SigmaPx = 2.0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Say everything that can be known to be wrong with CASE before solving, all at once."""
    from screwpose.cli.words import told_findings
    from screwpose.jobs import check_files

    findings = check_files(case, landmark_sigma)
    errors = sum(finding.level == "error" for finding in findings)
    if as_json:
        listed = [finding.as_dict() for finding in findings]
        say_json({"case": str(case), "errors": errors, "warnings": len(findings) - errors, "findings": listed})
    elif errors or not quiet:
        typer.echo(told_findings(case, findings))
    if errors:
        raise typer.Exit(BAD_INPUT)


@app.command()
@answers_errors
def simulate(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write the case into.")],
    set_name: Annotated[str | None, typer.Option("--set", help="A case of this benchmark set, instead.")] = None,
    seed: Seed = 0,
    index: Annotated[int, typer.Option(min=0, help="Which case of the set.")] = 0,
    screws: Annotated[int | None, typer.Option(min=1, max=16, help="How many screws.", show_default="2")] = None,
    angle: Annotated[
        float | None, typer.Option(help="Angle between the views, degrees.", show_default="84 to 96")
    ] = None,
    overlap: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Least and largest share of a screw that others cover in LAT.", show_default="0.05 1"),
    ] = None,
    tilt: Annotated[float | None, typer.Option(help="Polyaxial screws whose towers lean by this, degrees.")] = None,
    clutter: Annotated[int | None, typer.Option(min=0, help="Pieces of other metal.", show_default="0")] = None,
    missing: Annotated[int | None, typer.Option(min=0, help="Marks that are missing.", show_default="0")] = None,
    needles: Annotated[bool, typer.Option("--needles", help="Add X-rays with a needle along each tower.")] = False,
    landmark_noise: Annotated[
        float | None, typer.Option(min=0.0, help="Noise of the landmarks, px.", show_default="1.5")
    ] = None,
    tip_bias: Annotated[float | None, typer.Option(help="Tips are marked this far towards the head, mm.")] = None,
    center_bias: Annotated[float | None, typer.Option(help="And centres, mm.")] = None,
    focal_error: Annotated[float | None, typer.Option(min=0.0, help="Error of P: focal length, %.")] = None,
    principal_error: Annotated[float | None, typer.Option(min=0.0, help="Error of P: principal point, px.")] = None,
    rotation_error: Annotated[float | None, typer.Option(min=0.0, help="Error of P: LAT turned, degrees.")] = None,
    translation_error: Annotated[float | None, typer.Option(min=0.0, help="Error of P: LAT moved, mm.")] = None,
    pincushion: Annotated[
        float | None, typer.Option(help="Pincushion: share of the radius, at half the image's side.")
    ] = None,
    s_distortion: Annotated[float | None, typer.Option(help="S distortion: turn at half the side, degrees.")] = None,
    cad_length_error: Annotated[float | None, typer.Option(help="The given CAD is longer by this, mm.")] = None,
    cad_diameter_error: Annotated[float | None, typer.Option(help="And thicker by this, mm.")] = None,
    motion: Annotated[float | None, typer.Option(min=0.0, help="The patient moves before LAT, mm.")] = None,
    motion_turn: Annotated[float | None, typer.Option(min=0.0, help="And turns, degrees.")] = None,
    size: Annotated[
        int | None, typer.Option(min=128, max=4096, help="Width and height of the images, px.", show_default="1024")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make a case with its truth: two screws with towers seen in AP and LAT, or what the options say."""
    from screwpose.cli.making import make_case_of_set, make_scene
    from screwpose.files.atomic import ensure_can_write_folder
    from screwpose.simulation.scenes_record import SCENE_FILE

    dials = {
        "screws": screws,
        "angle": angle,
        "overlap": overlap,
        "tilt": tilt,
        "clutter": clutter,
        "missing": missing,
        "needles": needles or None,
        "landmark_noise": landmark_noise,
        "tip_bias": tip_bias,
        "center_bias": center_bias,
        "focal_error": focal_error,
        "principal_error": principal_error,
        "rotation_error": rotation_error,
        "translation_error": translation_error,
        "pincushion": pincushion,
        "s_distortion": s_distortion,
        "cad_length_error": cad_length_error,
        "cad_diameter_error": cad_diameter_error,
        "motion": motion,
        "motion_turn": motion_turn,
        "size": size,
    }
    if set_name is None and index:
        raise InputError(f"case {index} of no set", field="--index", remedy="Add --set NAME, or use --seed.")
    ensure_can_write_folder(out, marker=SCENE_FILE)
    with shown_progress(quiet or as_json) as progress:
        progress(0.0, "X-raying a simulated patient")
        path = make_scene(out, seed, dials) if set_name is None else make_case_of_set(out, set_name, seed, index, dials)
    if as_json:
        say_json({"case": str(path), "truth": str(path.parent / "truth.json")})
    elif not quiet:
        command = shlex.join(["screwpose", "solve", str(out), "-o", f"{out.name}-solved"])
        typer.echo(f"{path}\nSolve it with: {command}")


app.command()(bench)


@app.command("open")
@answers_errors
def open_workbench(
    path: Annotated[
        Path | None, typer.Argument(help="A case, or a folder of cases; without it the folder screwpose-cases at home.")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Where it listens; 0: any that is free.")] = 0,
    host: Annotated[
        str, typer.Option(help="Another address to listen on; then the printed address has a token that is asked for.")
    ] = "127.0.0.1",
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the browser.")] = False,
) -> None:
    """Open the workbench: mark, solve, review and export a case in the browser."""
    import threading
    import webbrowser

    from screwpose.workbench import serve

    def ready(address: str) -> None:
        typer.echo(f"The workbench is ready; Ctrl-C ends it. Research software, not a medical device.\n{address}")
        if not no_browser:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    serve(path, ready, host, port)


@model_app.command("inspect")
@answers_errors
def inspect_model(
    file: Annotated[Path, typer.Argument(help="STL, OBJ, PLY, VTK or STEP.")],
    unit: Annotated[str, typer.Option(help="Unit of the file's coordinates: mm, cm, m, inch.")] = "mm",
    picture: Annotated[
        Path | None, typer.Option("-o", "--picture", help="PNG to draw; default: FILE's name with _inspect.png, here.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Report on a mesh, propose its tip and centre, and draw it."""
    from screwpose.cli.words import model_facts, told_model
    from screwpose.implants import draw_mesh, mesh_report, propose_landmarks, read_mesh

    mesh = read_mesh(file, unit)
    report, proposal = mesh_report(mesh), propose_landmarks(mesh)
    drawn = picture or Path(f"{file.stem}_inspect.png")
    draw_mesh(mesh, proposal, drawn)
    if as_json:
        say_json({"file": str(file), "unit": unit, "picture": str(drawn), **model_facts(report, proposal)})
    elif not quiet:
        typer.echo(told_model(file, unit, report, proposal, drawn))


def _leave_by(status: str) -> None:
    if status == "refused":
        raise typer.Exit(REFUSED)


def main() -> None:
    """The program `screwpose`."""
    app()
