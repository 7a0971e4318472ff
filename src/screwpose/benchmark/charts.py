"""The plots of a run's page, as SVG that takes the page's own colours, so that it is read in light and in dark."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from screwpose.benchmark.measures_blocks import error_values
from screwpose.benchmark.measures_file import Offset, Rate, SetMeasures, Stratum
from screwpose.benchmark.record import CaseRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

# Okabe & Ito (2008), those that can be told from a white and from a dark page alike.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES = ("-", "--", "-.", ":")
_MARKERS = ("o", "s", "^", "D", "v", "P")
# Stand-ins that become the page's own colours in the SVG.
_INK, _LINE = "#010203", "#040506"
_SIZE_INCHES = (5.2, 3.4)
_MAX_STEPS = 300
_SMALLEST_ERROR = 1e-3


@dataclass(frozen=True)
class Chart:
    """A plot with its title, one sentence on how to read it, and its SVG."""

    title: str
    words: str
    svg: str


Methods = Mapping[str, Sequence[CaseRecord]]


def charts_of(name: str, methods: Methods, measures: SetMeasures) -> list[Chart]:
    """All plots of a set that its data allow.

    Parameters
    ----------
    name : of the set; it keeps the ids of one page's plots apart.
    methods : the records by method.
    """
    styles = {method: _style(index) for index, method in enumerate(methods)}
    pens = {method: {"color": style["color"], "linestyle": style["linestyle"]} for method, style in styles.items()}
    made = [
        _ecdf(name, methods, "tip_mm", "Tip error", "mm", pens),
        _ecdf(name, methods, "axis_deg", "Axis error", "degrees", pens),
        _against_stratum(
            name,
            measures,
            styles,
            "landmark_noise_px",
            "Success against landmark noise",
            "landmark noise, px",
            lambda one: one.success,
        ),
        _against_offset(name, measures, styles),
        _against_stratum(
            name,
            measures,
            styles,
            "epipolar_ambiguity_px",
            "Pairing against epipolar ambiguity",
            "epipolar ambiguity, px",
            lambda one: one.right,
        ),
        _calibration(name, measures, styles),
        _times(name, methods, styles),
    ]
    return [one for one in made if one is not None]


def _style(index: int) -> dict[str, Any]:
    return {
        "color": _COLORS[index % len(_COLORS)],
        "linestyle": _DASHES[index % len(_DASHES)],
        "marker": _MARKERS[index % len(_MARKERS)],
    }


def _ecdf(
    name: str, methods: Methods, key: str, title: str, unit: str, styles: Mapping[str, dict[str, Any]]
) -> Chart | None:
    errors = {method: [value for _, value in error_values(records, key)] for method, records in methods.items()}
    if not any(errors.values()):
        return None

    def draw(axes: "Axes") -> None:
        for method, values in errors.items():
            screws = sum(len(record.screws) for record in methods[method])
            x = np.maximum(np.sort(values), _SMALLEST_ERROR)
            share = np.arange(1, len(x) + 1) / max(screws, 1)
            if len(x) > _MAX_STEPS:
                kept = np.unique(np.rint(np.linspace(0, len(x) - 1, _MAX_STEPS)).astype(int))
                x, share = x[kept], share[kept]
            axes.step(x, share, where="post", label=method, linewidth=1.8, **styles[method])
        axes.set_xscale("log")
        _plain_decades(axes.xaxis)
        axes.set_ylim(0, 1.02)
        axes.set_xlabel(f"{title.lower()}, {unit}")
        axes.set_ylabel("share of all screws")

    words = "Share of all screws with a smaller error; what a line lacks to 1 was paired wrong or not at all."
    return Chart(title, words, _svg(f"{name}-{key}", draw))


def _against_stratum(
    name: str,
    measures: SetMeasures,
    styles: Mapping[str, dict[str, Any]],
    stratum: str,
    title: str,
    label: str,
    rate: Callable[[Stratum], Rate],
) -> Chart | None:
    bins = {method: one.strata[stratum] for method, one in measures.methods.items()}
    found = {method: [(one, rate(one)) for one in some if one.low is not None] for method, some in bins.items()}
    return _rates(f"{name}-{stratum}", found, styles, title, label)


def _against_offset(name: str, measures: SetMeasures, styles: Mapping[str, dict[str, Any]]) -> Chart | None:
    found = {method: [(bin_, bin_.success) for bin_ in one.offsets] for method, one in measures.methods.items()}
    title = "Success against initial offset"
    return _rates(f"{name}-offset", found, styles, title, "offset of the tip at the start, mm")


def _rates(
    salt: str,
    found: Mapping[str, Sequence[tuple[Stratum | Offset, Rate]]],
    styles: Mapping[str, dict[str, Any]],
    title: str,
    label: str,
) -> Chart | None:
    names = {one.low: one.name for some in found.values() for one, _ in some if one.low is not None}
    places = {low: place for place, low in enumerate(sorted(names))}
    if len(places) < 2:
        return None

    def draw(axes: "Axes") -> None:
        for shift, (method, some) in zip(_shifts(len(found)), found.items(), strict=True):
            known = [(places[one.low] + shift, rate) for one, rate in some if one.low is not None]
            if known:
                _points(axes, known, styles[method], method)
        axes.set_xticks(
            list(places.values()), [names[low].replace(" and more", "+").replace(" to ", "-") for low in places]
        )
        axes.set_ylim(-0.02, 1.04)
        axes.set_xlabel(label)
        axes.set_ylabel("share")

    return Chart(title, "Bars are 95 % intervals; bins without cases are left out.", _svg(salt, draw))


def _calibration(name: str, measures: SetMeasures, styles: Mapping[str, dict[str, Any]]) -> Chart | None:
    told = {method: one.calibration for method, one in measures.methods.items() if one.calibration is not None}
    if not told:
        return None

    def draw(axes: "Axes") -> None:
        axes.plot([0, 1], [0, 1], color=_LINE, linewidth=1)
        for method, one in told.items():
            _points(axes, [(bin_.mean_probability, bin_.right) for bin_ in one.bins], styles[method], method)
        axes.set_xlim(-0.02, 1.04)
        axes.set_ylim(-0.02, 1.04)
        axes.set_xlabel("probability that was told")
        axes.set_ylabel("share that is right")

    words = "On the diagonal a probability means what it says; below it the method is too sure of itself."
    return Chart("Calibration of the probabilities", words, _svg(f"{name}-calibration", draw))


def _times(name: str, methods: Methods, styles: Mapping[str, dict[str, Any]]) -> Chart | None:
    solved = {method: [one for one in records if one.error is None] for method, records in methods.items()}
    numbers = sorted({len(record.screws) for records in solved.values() for record in records if record.screws})
    if not numbers:
        return None

    def draw(axes: "Axes") -> None:
        for shift, (method, records) in zip(_shifts(len(solved)), solved.items(), strict=True):
            x, middle, low, high = [], [], [], []
            for number in numbers:
                seconds = [one.seconds for one in records if len(one.screws) == number]
                if seconds:
                    a, b, c = np.quantile(seconds, [0.1, 0.5, 0.9])
                    x.append(number + shift)
                    middle.append(b)
                    low.append(b - a)
                    high.append(c - b)
            axes.errorbar(
                x, middle, [low, high], label=method, capsize=2, markersize=5, linewidth=1.5, **styles[method]
            )
        axes.set_yscale("log")
        low_s, high_s = axes.get_ylim()
        axes.set_ylim(low_s / 1.5, high_s * 1.5)  # times that hardly differ look so
        _plain_decades(axes.yaxis)
        axes.set_xticks(numbers)
        axes.set_xlim(numbers[0] - 0.6, numbers[-1] + 0.6)
        axes.set_xlabel("screws of the case")
        axes.set_ylabel("seconds a case")

    words = "Median, and the range from the 10th to the 90th percentile."
    return Chart("Time against number of screws", words, _svg(f"{name}-time", draw))


def _plain_decades(axis: "Axis") -> None:
    """0.1, 0.2, 0.5, 1 in place of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _points(axes: "Axes", known: Sequence[tuple[float, Rate]], style: dict[str, Any], method: str) -> None:
    x = [place for place, _ in known]
    y = [rate.value for _, rate in known]
    spread = [[rate.value - rate.low for _, rate in known], [rate.high - rate.value for _, rate in known]]
    axes.errorbar(x, y, spread, label=method, capsize=2, markersize=5, linewidth=1.5, **style)


def _shifts(count: int) -> list[float]:
    """Side by side, so that bars of equal height do not hide each other."""
    return [0.08 * (index - 0.5 * (count - 1)) for index in range(count)]


def _svg(salt: str, draw: Callable[["Axes"], None]) -> str:
    """A figure as SVG that may stand in a page among others.

    Parameters
    ----------
    salt : keeps the ids of one plot apart from those of the others.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    style: Any = {  # matplotlib types the names of all its settings, one by one
        "svg.fonttype": "none",
        "svg.hashsalt": salt,
        "font.size": 10,
        "text.color": _INK,
        "axes.labelcolor": _INK,
        "axes.edgecolor": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "grid.color": _LINE,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.frameon": False,
    }
    with mpl.rc_context(style):
        figure = Figure(figsize=_SIZE_INCHES)
        figure.set_layout_engine("constrained")
        axes = figure.add_subplot()
        draw(axes)
        figure.legend(loc="outside upper left", ncols=4, fontsize=10)
        buffer = io.StringIO()
        none = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", transparent=True, metadata=none)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # What a whole file needs and a page does not: its style would reach into all of the page.
    for part in ("metadata", "style"):
        text = re.sub(rf"<{part}\b.*?</{part}>", "", text, flags=re.DOTALL)
    text = re.sub(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', r"<svg \1", text)
    text = re.sub(r'height="[^"]*pt" |width="[^"]*pt" ', "", text, count=2)
    text = re.sub(r'id="(figure|axes|patch|line2d|text|xtick|ytick|legend|matplotlib|LineCollection)_[^"]*"', "", text)
    return text.replace(_INK, "currentColor").replace(_LINE, "var(--line)")
