"""Everything that a result's folder holds, written into a folder that the caller made."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from screwpose.files.atomic import write_bytes, write_json, write_text
from screwpose.files.case import Case
from screwpose.files.result import Result
from screwpose.images.encoding import encode_png
from screwpose.report.comparison import Comparison
from screwpose.report.drawings import Drawings, draw
from screwpose.report.html import report_html
from screwpose.report.meshes import make_folder, unique_names, write_meshes
from screwpose.report.overlays import combination_figure, overlay_of_shadows
from screwpose.report.palette import Palette
from screwpose.report.space import arrange
from screwpose.report.tables import combination_table
from screwpose.report.words import combination_verdict

Progress: TypeAlias = Callable[[float, str], None]
"""``progress(fraction, what)``: told how far the work is; may raise CancelledError to stop it."""


def write_report(
    folder: str | Path,
    case: Case,
    result: Result,
    comparison: Comparison | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Write result.json, overlays, the table of combinations, placed meshes and report.html.

    Parameters
    ----------
    folder : an existing folder, as `screwpose.files.atomic_folder` gives it.
    case, result : what was asked and answered. A refused result is reported too: images, landmarks and the reason.
    comparison : the errors against a known truth, and the true pairs and poses, where there are any.
    progress : told the fraction done before every step; what it raises stops the writing.

    Returns
    -------
    The files written, in the order of writing.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    folder = Path(folder)
    tell = progress or _tell_nobody
    tell(0.0, "result.json")
    paths = [write_json(folder / "result.json", result.answer)]
    tell(0.05, "projections")
    palette = Palette.of_case(case)
    drawings = draw(case, result, palette, comparison)
    tell(0.3, "overlays")
    paths += _write_overlays(folder, case, result, drawings, comparison)
    tell(0.7, "tables and meshes")
    paths += _write_table(folder, result, comparison)
    paths += write_meshes(folder, result.answer.screws, case.implants)
    tell(0.8, "report.html")
    space = arrange(case, result, drawings, palette, comparison)
    page = report_html(case, result, drawings, space, palette, comparison)
    paths.append(write_text(folder / "report.html", page))
    tell(1.0, "report.html")
    return paths


def _tell_nobody(_fraction: float, _what: str) -> None:
    pass


def _write_overlays(
    folder: Path, case: Case, result: Result, drawings: Drawings, comparison: Comparison | None
) -> list[Path]:
    place = make_folder(folder / "overlays")
    names = dict(zip(case.views, unique_names(list(case.views)), strict=True))
    paths = []
    for (number, stage, view), shadows in drawings.shadows.items():
        picture = overlay_of_shadows(case.views[view], shadows, case.annotations.get(view, ()))
        paths.append(write_bytes(place / f"{names[view]}_combination{number}_{stage}.png", encode_png(picture)))
    by_id = {one.id: one for one in result.answer.combinations}
    for number in drawings.combinations:
        if number not in by_id or not drawings.panels_of(number):
            continue
        figure = combination_figure(
            case.views,
            by_id[number],
            drawings.panels_of(number),
            case.annotations,
            drawings.crops,
            combination_verdict(by_id[number], drawings.chosen, comparison),
        )
        paths.append(write_bytes(place / f"combination{number}.png", encode_png(figure)))
    if not drawings.shadows:
        for view, name in names.items():
            picture = overlay_of_shadows(case.views[view], (), case.annotations.get(view, ()))
            paths.append(write_bytes(place / f"{name}_landmarks.png", encode_png(picture)))
    return paths


def _write_table(folder: Path, result: Result, comparison: Comparison | None) -> list[Path]:
    if not result.answer.combinations:
        return []
    true_pairs = None if comparison is None else comparison.true_pairs
    table = combination_table([result.answer], None if true_pairs is None else {result.answer.case: true_pairs})
    return [
        write_text(folder / "combinations.csv", table.to_csv()),
        write_text(folder / "combinations.md", f"{table.title}\n\n{table.to_markdown()}"),
    ]
