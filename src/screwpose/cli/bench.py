"""The command `screwpose bench`."""

import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from screwpose.cli.options import (
    AsJson,
    CamerasName,
    CamerasOption,
    EngineName,
    EngineOption,
    Faces,
    Generations,
    MaxRoll,
    MaxShift,
    MaxTilt,
    Population,
    Quiet,
    RefinementName,
    RefinementOption,
    Seed,
    SigmaPx,
    check_faces,
    chosen,
)
from screwpose.cli.terminal import UNFORESEEN, WORSE, answers_errors, say_json, shown_progress
from screwpose.errors import CancelledError, InputError

if TYPE_CHECKING:
    from screwpose.benchmark.request import BenchRequest

# The options on the command line that have another name in run.json.
_OPTION_OF = {
    "sigma_px": "landmark_sigma",
    "max_shift_mm": "max_shift",
    "max_tilt_deg": "max_tilt",
    "max_roll_deg": "max_roll",
}


@answers_errors
def bench(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder to write into; required, but for --list.")
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="Say which sets and methods there are, and leave.")] = False,
    sets: Annotated[str, typer.Option("--set", help="Which cases: one set, or several with commas.")] = "paper",
    cases: Annotated[
        Path | None, typer.Option(help="Your own cases, in place of a set: a folder of folders with case and truth.")
    ] = None,
    methods: Annotated[
        str, typer.Option("--method", help="One method, or several with commas; module:function for your own.")
    ] = "default",
    count: Annotated[
        int | None, typer.Option(min=1, help="How many cases of each set, at most; default: 10, or all of --cases.")
    ] = None,
    seed: Seed = 1,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine; default: one for each core.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="A dask scheduler, tcp://HOST:PORT, in place of --workers.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on in a folder where a run was stopped.")] = False,
    keep_cases: Annotated[bool, typer.Option("--keep-cases", help="Keep the cases: images, models, truth.")] = False,
    baseline: Annotated[
        Path | None, typer.Option(help="The measures.json of an earlier run: being worse leaves by 6.")
    ] = None,
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
    """Measure methods on cases with known truth; a run that is stopped goes on with --resume."""
    # Before numpy is imported: the last digit of a long sum depends on how many threads share it, and records are to be
    # the same with any number of workers, which have one each.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from screwpose.benchmark.runner import can_use_workers, run_bench, usual_workers
    from screwpose.cli import words_bench

    if listed:
        if as_json:
            say_json(words_bench.listing())
        else:
            typer.echo(words_bench.told_listing())
        return
    if out is None:
        raise typer.BadParameter("a folder to write into is missing", param_hint="-o")
    if workers is not None and scheduler is not None:
        raise InputError("both --workers and --scheduler are given", remedy="A scheduler has workers of its own.")
    check_faces(faces)
    asked = {"sets": _names(sets), "cases": cases, "methods": _names(methods), "count": count, "seed": seed}
    solver = {
        "engine": chosen(engine),
        "refinement": chosen(refinement),
        "cameras": cameras.value,
        "faces": faces,
        "generations": generations,
        "population": population,
        "sigma_px": landmark_sigma,
        "max_shift_mm": max_shift,
        "max_tilt_deg": max_tilt,
        "max_roll_deg": max_roll,
    }
    if workers is None and scheduler is None and not (can_use_workers() or quiet or as_json):
        typer.echo("One case at a time: the extra screwpose[cluster] is not installed.", err=True)
    request = _request(context, out, resume, asked, solver)
    with shown_progress(quiet or as_json) as progress, _says_how_to_go_on(out, request):
        run = run_bench(
            request,
            out,
            workers=workers or usual_workers(),
            scheduler=scheduler,
            resume=resume,
            keep_cases=keep_cases,
            baseline=baseline,
            progress=progress,
        )
    if as_json:
        say_json(words_bench.summary(run))
    elif not quiet:
        typer.echo(words_bench.told_run(run))
    if run.unforeseen:
        typer.echo(words_bench.told_unforeseen(run), err=True)
        raise typer.Exit(UNFORESEEN)
    if run.worse:
        typer.echo(words_bench.told_worse(run), err=True)
        raise typer.Exit(WORSE)


def _request(
    context: typer.Context, out: Path, resume: bool, asked: dict[str, Any], solver: dict[str, Any]
) -> "BenchRequest":
    """What is asked for: by the command line; where a run is resumed, by its folder but for what is said anew."""
    from screwpose.benchmark.request import AskedOptions, make_request, same_again
    from screwpose.benchmark.run_folder import stored_request

    stored = stored_request(out) if resume else None
    if stored is None:
        if asked["cases"] is not None and not _is_said(context, "sets"):
            asked = {**asked, "sets": ()}
        return make_request(**asked, options=AskedOptions(**solver).solve_options(0))
    said = {name: value for name, value in asked.items() if _is_said(context, name)}
    again = {name: value for name, value in solver.items() if _is_said(context, _OPTION_OF.get(name, name))}
    return same_again(stored, **said, options=stored.options.model_copy(update=again).solve_options(0))


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _is_said(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


@contextmanager
def _says_how_to_go_on(out: Path, request: "BenchRequest") -> Iterator[None]:
    """Answer Ctrl-C by what is done and the command to go on with."""
    try:
        yield
    except KeyboardInterrupt:
        done = len(list(out.glob("records/*/*.json")))
        every = request.cases * len(request.methods)
        command = shlex.join(["screwpose", "bench", "-o", str(out), "--resume"])
        raise CancelledError(f"stopped; {done} of {every} records are done and kept. Go on with: {command}") from None
