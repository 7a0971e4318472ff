"""What a run leaves beside its records: summary, measures, rows, tables and the page."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from screwpose.benchmark import tables
from screwpose.benchmark.gate import check_against, read_baseline
from screwpose.benchmark.measures_file import MeasuresFile
from screwpose.benchmark.measures_run import group
from screwpose.benchmark.measures_strata import STRATA
from screwpose.benchmark.page import page
from screwpose.benchmark.page_worst import WORST
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.rows import cases_csv, screws_csv
from screwpose.benchmark.sets import BenchmarkSet
from screwpose.benchmark.summary import measures_file, summarise
from screwpose.files.atomic import write_json, write_text
from screwpose.files.strict_json import read_json
from screwpose.report.meshes import make_folder
from screwpose.report.tables import Table

# Longer tables are no reading; they stand in files of their own.
_MAX_ROWS = 60


def write_outputs(
    folder: str | Path,
    records: Sequence[CaseRecord],
    sets: Mapping[str, BenchmarkSet],
    *,
    started: str | None = None,
    baseline: str | Path | None = None,
    worst: int = WORST,
) -> list[Path]:
    """Write cases.csv, screws.csv, measures.json, summary.json, tables and report.html, each file in one step.

    Parameters
    ----------
    folder : of the run: its results are read for the paper's tables and the overlays.
    records : all of the run, in any order.
    sets : by name; the worst cases are made again by them.
    started : when the run began, ISO 8601; None: as run.json says, else now.
    baseline : a measures.json that the page compares with.
    worst : so many of the worst cases are drawn for each method.

    Returns
    -------
    The paths.

    Raises
    ------
    OutputError
        The folder cannot be written.
    CaseError
        The baseline cannot be used.
    """
    folder = Path(folder)
    ordered = [record for methods in group(records).values() for some in methods.values() for record in some]
    seed = ordered[0].seed if ordered else 0
    measures = measures_file(ordered, seed=seed, started=started or _started(folder))
    summary = summarise(measures)
    worsened = None if baseline is None else check_against(read_baseline(baseline), ordered)
    paths = [
        write_text(folder / "cases.csv", cases_csv(ordered)),
        write_text(folder / "screws.csv", screws_csv(ordered)),
        *write_tables(folder, ordered, measures),
        write_json(folder / "measures.json", measures),
        write_json(folder / "summary.json", summary),
    ]
    html = page(folder, ordered, sets, measures, summary, worsened, worst, _unusual_options(folder))
    return [*paths, write_text(folder / "report.html", html)]


def _asked(folder: Path, key: str) -> object:
    """What run.json has; None where it has not, or is not there."""
    asked = read_json(folder / "run.json") if (folder / "run.json").is_file() else {}
    return asked.get(key) if isinstance(asked, dict) else None


def _unusual_options(folder: Path) -> list[str]:
    """The options of run.json that differ from what a run has by itself, as in ``generations 4``."""
    from screwpose.benchmark.request import AskedOptions

    asked, usual = _asked(folder, "options"), AskedOptions().model_dump()
    given = asked if isinstance(asked, dict) else {}
    return [f"{name} {given[name]}" for name, value in usual.items() if name in given and given[name] != value]


def _started(folder: Path) -> str:
    """When the run began, by its run.json; now where there is none."""
    started = _asked(folder, "started")
    return started if isinstance(started, str) else datetime.now(UTC).isoformat(timespec="seconds")


def write_tables(folder: Path, records: Sequence[CaseRecord], measures: MeasuresFile) -> list[Path]:
    """tables.md, and every table as CSV in tables/, the paper's two for each set and method among them."""
    place = make_folder(folder / "tables")
    whole = {
        "pairing": tables.headline_table(measures),
        "confidence": tables.confidence_table(measures),
        "accuracy": tables.accuracy_table(measures),
    }
    ratios = tables.ratio_table(summarise(measures))
    if ratios.rows:
        whole["ratios"] = ratios
    paths = [write_text(place / f"{name}.csv", table.to_csv()) for name, table in whole.items()]
    texts = [_section(table) for table in whole.values()]
    for name, methods in group(records).items():
        some = measures.sets[name]
        for stratum in STRATA:
            table = tables.stratum_table(stratum, some)
            if len(table.rows) > 1:
                paths.append(write_text(place / f"{name}-{stratum}.csv", table.to_csv()))
                texts.append(_section(table, f"{name}: {table.title}"))
        for method, listed in methods.items():
            table1, table2 = tables.paper_tables(folder, listed)
            errors = tables.error_table(some.methods[method])
            for key, table in (("errors", errors), ("table1", table1), ("table2", table2)):
                if table.rows:
                    paths.append(write_text(place / f"{name}-{method}-{key}.csv", table.to_csv()))
                    texts.append(_section(table, f"{name}, {method}: {table.title}"))
    return [*paths, write_text(folder / "tables.md", "# Benchmark\n\n" + "\n".join(texts))]


def _section(table: Table, title: str | None = None) -> str:
    shown = Table(table.title, table.columns, table.rows[:_MAX_ROWS], table.emphasis)
    rest = "" if len(table.rows) <= _MAX_ROWS else f"\n{len(table.rows)} rows; all of them are in tables/.\n"
    return f"## {title or table.title}\n\n{shown.to_markdown()}{rest}"
