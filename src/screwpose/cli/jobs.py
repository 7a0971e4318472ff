"""The jobs of the front door: from files to files."""

from pathlib import Path
from time import perf_counter

from screwpose.errors import OutputError
from screwpose.files.atomic import atomic_folder, ensure_can_write_folder
from screwpose.files.case import Case, read_case
from screwpose.files.result import Result, with_load_time
from screwpose.jobs import saying_that_it_compiles
from screwpose.registration import Progress
from screwpose.report.comparison import Comparison
from screwpose.solve import SolveOptions, solve

_DEMO_NOISE_PX = 1.5  # on 1024 pixels


def solve_files(
    case_path: str | Path, out: str | Path, options: SolveOptions, progress: Progress, truth_origin: str | None = None
) -> tuple[Result, Comparison | None]:
    """Read a case, solve it, and write its report folder; nothing is written unless all of it is.

    Parameters
    ----------
    truth_origin : score against the truth.json beside the case, which comes from there; None: do not look at it.
    """
    from screwpose.report.writing import write_report

    ensure_can_write_folder(out)
    _refuse_to_replace(Path(case_path), Path(out))
    start = perf_counter()
    progress(0.0, "reading the case")
    case = read_case(case_path)
    loaded = perf_counter() - start
    solving = saying_that_it_compiles(lambda fraction, what: progress(0.02 + 0.88 * fraction, what))
    result = with_load_time(solve(case, options, solving), loaded)
    comparison = None if truth_origin is None else _compared(case, result, Path(case_path), truth_origin)
    with atomic_folder(out) as partial:
        write_report(partial, case, result, comparison, lambda fraction, what: progress(0.9 + 0.1 * fraction, what))
    return result, comparison


def run_demo(
    out: str | Path, seed: int, size_px: int, options: SolveOptions, progress: Progress
) -> tuple[Result, Comparison | None]:
    """Simulate a two-screw case into ``out/case``, and solve it as a user's case would be.

    Everything of it is in `out` afterwards: the case with its truth, the result, the report.
    """
    from screwpose.report.writing import write_report
    from screwpose.simulation.scenes import two_screw_scene
    from screwpose.simulation.writing import write_case

    ensure_can_write_folder(out)
    with atomic_folder(out) as partial:
        progress(0.0, "X-raying a simulated patient with two pedicle screws")
        # A mark is as far off on the detector whatever the pixels' size.
        noise_px = _DEMO_NOISE_PX * size_px / 1024
        scene = two_screw_scene(seed, landmark_noise_px=noise_px, image_size=(size_px, size_px))
        case_path = write_case(scene, partial / "case")
        start = perf_counter()
        case = read_case(case_path)
        loaded = perf_counter() - start
        solving = saying_that_it_compiles(lambda fraction, what: progress(0.05 + 0.85 * fraction, what))
        solved = solve(case, options, solving)
        result = with_load_time(solved, loaded)
        comparison = _compared(case, result, case_path, "simulated")
        write_report(partial, case, result, comparison, lambda fraction, what: progress(0.9 + 0.1 * fraction, what))
    return result, comparison


def _refuse_to_replace(case_path: Path, out: Path) -> None:
    """An earlier output is replaced whole: a case that lies in it would be lost.

    Raises
    ------
    OutputError
        The case is in the output folder, as the demo's is in the demo's.
    """
    from screwpose.files.case import case_file

    if out.resolve() in case_file(case_path).resolve().parents:
        raise OutputError(
            f"{out}: the case {case_path} lies in this folder, which the output would replace. Write to another folder."
        )


def _compared(case: Case, result: Result, case_path: Path, origin: str) -> Comparison:
    from screwpose.benchmark.scoring import compare
    from screwpose.files.case import case_file
    from screwpose.files.truth import read_truth

    truth = read_truth(case_file(case_path).parent / "truth.json")
    return compare(result.answer, truth, case.implants, origin)
