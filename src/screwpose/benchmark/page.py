"""report.html of a benchmark run: one file that holds everything and asks the network for nothing."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from screwpose.benchmark import tables
from screwpose.benchmark.charts import charts_of
from screwpose.benchmark.measures_file import MeasuresFile
from screwpose.benchmark.measures_run import group
from screwpose.benchmark.measures_strata import STRATA
from screwpose.benchmark.page_worst import WORST, draw_worst
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.sets import BenchmarkSet
from screwpose.files.schema import SummaryFile
from screwpose.report.words import DISCLAIMER

_MAX_REFUSED = 100


def page(
    folder: Path,
    records: Sequence[CaseRecord],
    sets: Mapping[str, BenchmarkSet],
    measures: MeasuresFile,
    summary: SummaryFile,
    worsened: Sequence[str] | None = None,
    worst: int = WORST,
    unusual: Sequence[str] = (),
) -> str:
    """The page.

    Parameters
    ----------
    folder : of the run, where results (and kept cases) are.
    worsened : what became worse against a baseline, in words; None where there is none to compare with.
    worst : so many of the worst cases are drawn for each method.
    unusual : the options that the methods ran with and that are not the usual ones, in words.
    """
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    own = files("screwpose.benchmark") / "templates"
    template = environment.from_string((own / "bench.html.j2").read_text(encoding="utf-8"))
    house = (files("screwpose.report") / "assets" / "report.css").read_text(encoding="utf-8")
    grouped = group(records)
    methods: dict[str, list[CaseRecord]] = {}
    for record in records:
        methods.setdefault(record.method, []).append(record)
    refused = [one for one in records if one.pairing_status == "refused"]
    return template.render(
        measures=measures,
        disclaimer=DISCLAIMER,
        unusual=unusual,
        # Ours, not a case's: taken as they are.
        style=Markup(house + (own / "bench.css").read_text(encoding="utf-8")),
        headline=tables.headline_table(measures),
        confidence=tables.confidence_table(measures),
        accuracy=tables.accuracy_table(measures),
        ratios=tables.ratio_table(summary),
        worsened=worsened,
        sets=[_set(name, grouped[name], sets.get(name), measures) for name in measures.sets],
        worst=draw_worst(folder, methods, sets, worst),
        refused=[_refusal(one) for one in refused[:_MAX_REFUSED]],
        refused_count=len(refused),
        failed_count=sum(one.error is not None for one in records),
    )


def _set(
    name: str, methods: Mapping[str, Sequence[CaseRecord]], known: BenchmarkSet | None, measures: MeasuresFile
) -> dict[str, Any]:
    from markupsafe import Markup

    some = measures.sets[name]
    charts = charts_of(name, methods, some)
    strata = [tables.stratum_table(stratum, some) for stratum in STRATA]
    return {
        "name": name,
        "version": some.version,
        "description": "" if known is None else known.description,
        "origin": "" if known is None else known.origin,
        "charts": [{"title": one.title, "words": one.words, "svg": Markup(one.svg)} for one in charts],
        "errors": [(method, tables.error_table(one), tables.more_table(one)) for method, one in some.methods.items()],
        "strata": [table for table in strata if len(table.rows) > 1],
    }


def _refusal(record: CaseRecord) -> dict[str, str]:
    text = record.error or "; ".join(record.reasons) or "no reason was given"
    return {
        "case": f"{record.set}-{record.index:04d} ({record.case})",
        "method": record.method,
        "kind": "failed" if record.error is not None else "refused",
        # What a bug left behind has its place in the record, not here.
        "reason": text.splitlines()[0],
    }
