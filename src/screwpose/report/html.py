"""report.html: one file that holds everything and asks the network for nothing."""

import base64
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Annotation, Case, View
from screwpose.files.result import Result
from screwpose.files.schema import ScrewResultFile
from screwpose.images.encoding import encode_png
from screwpose.report.comparison import Comparison
from screwpose.report.drawings import Drawings
from screwpose.report.overlays import Box, GreyArray, display_grey
from screwpose.report.palette import Palette, screw_name
from screwpose.report.shadows import Shadow, mask_outlines
from screwpose.report.space import Space, page_data
from screwpose.report.still import still_picture
from screwpose.report.tables import combination_table, pairs_text
from screwpose.report.words import (
    DISCLAIMER,
    SCREW_STATUS_WORDS,
    STATUS_WORDS,
    combination_verdict,
    expected_error_text,
    pairing_story,
)

_LONGEST_SIDE_PX = 1400
_JPEG_QUALITY = 92
_USUAL_WIDTH_PX = 560  # of a picture on the page, until the script measures it
_DASH_ARRAYS = {"solid": "none", "dashed": "8 4", "dotted": "2 3"}


def report_html(
    case: Case,
    result: Result,
    drawings: Drawings,
    space: Space | None,
    palette: Palette,
    comparison: Comparison | None = None,
) -> str:
    """The page.

    All text from the case (labels, ids, warnings) is escaped; the page's own policy forbids any request.
    """
    import jinja2
    from markupsafe import Markup

    assets = files("screwpose.report") / "assets"
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        (files("screwpose.report") / "templates" / "report.html.j2").read_text(encoding="utf-8")
    )
    answer = result.answer
    true_pairs = None if comparison is None else comparison.true_pairs
    return template.render(
        case=case,
        answer=answer,
        comparison=comparison,
        comparison_rows=_comparison_rows(comparison, palette),
        drawings=drawings,
        disclaimer=DISCLAIMER,
        status=STATUS_WORDS[answer.status],
        pairing_status=STATUS_WORDS[answer.pairing.status],
        warnings=list(dict.fromkeys([*answer.warnings, *case.warnings])),
        story=pairing_story(case, answer),
        pairs=[{"name": screw_name(labels), "ink": palette.ink(labels)} for labels in answer.pairing.pairs],
        combinations=_combination_options(result, drawings, comparison),
        pictures=[_picture(view, case, result, drawings) for view in case.views.values()],
        table=combination_table([answer], None if true_pairs is None else {answer.case: true_pairs}).without("set"),
        screws=[_screw(index, one, case, drawings, palette) for index, one in enumerate(answer.screws)],
        space=space,
        space_data=None if space is None else page_data(space, case.views, drawings.crops),
        still=None if space is None else _data_uri("image/png", encode_png(still_picture(space))),
        # Ours, not the case's: taken as they are.
        style=Markup((assets / "report.css").read_text(encoding="utf-8")),
        script=Markup((assets / "report.js").read_text(encoding="utf-8")),
        viewer=Markup((assets / "viewer.js").read_text(encoding="utf-8")) if space is not None else "",
    )


def _combination_options(result: Result, drawings: Drawings, comparison: Comparison | None) -> list[dict[str, Any]]:
    by_id = {one.id: one for one in result.answer.combinations}
    drawn = [by_id[number] for number in drawings.combinations if number in by_id]
    return [
        {
            "id": one.id,
            "text": f"{one.id} ({combination_verdict(one, drawings.chosen, comparison)}): {pairs_text(one.pairs)}",
        }
        for one in drawn
    ]


def _comparison_rows(comparison: Comparison | None, palette: Palette) -> list[dict[str, Any]]:
    return [
        {
            "name": screw_name(one.labels),
            "ink": palette.ink(one.labels),
            "right": one.pairing_right,
            "errors": [
                "-" if value is None else f"{value:.{digits}f}"
                for value, digits in (
                    (one.tip_mm, 3),
                    (one.center_mm, 3),
                    (one.head_mm, 3),
                    (one.axis_deg, 3),
                    (one.roll_deg, 2),
                )
            ],
        }
        for one in (comparison.screws if comparison else ())
    ]


def _picture(view: View, case: Case, result: Result, drawings: Drawings) -> dict[str, Any]:
    """One view: the X-ray and, for each combination and stage, the shadows over it."""
    width, height = view.radiograph.size
    first = f"{drawings.chosen}-post"
    keys = [key for key in drawings.shadows if key[2] == view.name]
    names = [f"{number}-{stage}" for number, stage, _ in keys]
    first = first if first in names else next(iter(names), "")
    crop = drawings.crops[view.name]
    return {
        "name": view.name,
        "image": _xray(display_grey(view)),
        "width": width,
        "height": height,
        "crop": _view_box(crop),
        "whole": f"-0.5 -0.5 {width} {height}",
        "px": round(crop.size[0] / _USUAL_WIDTH_PX, 4),
        "clicks": [_click(one) for one in case.annotations.get(view.name, ())],
        "scenes": [
            {
                "key": name,
                "shown": name == first,
                "scores": _scores(result, key[0], key[1], view.name),
                "shadows": [_shadow(one) for one in drawings.shadows[key]],
            }
            for name, key in zip(names, keys, strict=True)
        ],
        "truth": [_path(one.outlines) for one in drawings.truth[view.name]],
        "mask": "" if view.mask.all() else _path(mask_outlines(view.mask)),
    }


def _screw(index: int, screw: ScrewResultFile, case: Case, drawings: Drawings, palette: Palette) -> dict[str, Any]:
    matrices = [("world_from_cad", screw.world_from_cad)]
    matrices += [(f"{name}: world_from_cad", part.world_from_cad) for name, part in (screw.parts or {}).items()]
    return {
        "name": screw_name(screw.labels),
        "ink": palette.ink(screw.labels),
        "status": screw.status,
        "status_text": SCREW_STATUS_WORDS[screw.status],
        "model": screw.model,
        "tip": _vector(screw.tip),
        "center": _vector(screw.center),
        "axis": _vector(screw.axis, 5),
        "sigma": expected_error_text(screw.sigma),
        "scores": screw.scores,
        "residuals": _residuals(screw, case, drawings),
        "matrices": [(f"matrix-{index}-{n}", name, _matrix(rows)) for n, (name, rows) in enumerate(matrices)],
    }


def _residuals(screw: ScrewResultFile, case: Case, drawings: Drawings) -> list[tuple[str, str]]:
    """How far the projected landmarks are from the marked ones, px, for each view that shows the screw."""
    texts = []
    for view, label in screw.labels.items():
        click = next((one for one in case.annotations.get(view, ()) if one.label == label), None)
        cast = drawings.shadows.get((drawings.chosen or 0, "post", view), ())
        shadow = next((one for one in cast if one.name == screw_name(screw.labels)), None)
        if click is None or shadow is None or shadow.tip_px is None or shadow.center_px is None:
            continue
        tip = float(np.linalg.norm(click.tip_px - shadow.tip_px))
        center = float(np.linalg.norm(click.center_px - shadow.center_px))
        texts.append((view, f"tip {tip:.1f} px, centre {center:.1f} px"))
    return texts


def _scores(result: Result, combination: int, stage: str, view: str) -> str:
    one = next((one for one in result.answer.combinations if one.id == combination), None)
    scores = None if one is None else one.pre if stage == "pre" else one.post
    if scores is None or view not in scores.views:
        return "not scored"
    return f"Dice {scores.views[view].dice:.3f}, loss {scores.views[view].loss:.3f}"


def _click(click: Annotation) -> dict[str, Any]:
    aside = 1 if click.center_px[0] >= click.tip_px[0] else -1
    return {"label": click.label, "tip": _uv(click.tip_px), "center": _uv(click.center_px), "aside": aside}


def _shadow(shadow: Shadow) -> dict[str, Any]:
    return {
        "name": shadow.name,
        "color": shadow.ink.color,
        "dash": _DASH_ARRAYS[shadow.ink.dash],
        "path": _path(shadow.outlines),
        "tip": None if shadow.tip_px is None else _uv(shadow.tip_px),
        "center": None if shadow.center_px is None else _uv(shadow.center_px),
    }


def _path(outlines: Sequence[FloatArray]) -> str:
    """Closed polygons as an SVG path."""
    return "".join(f"M{' '.join(f'{u:.2f},{v:.2f}' for u, v in outline)}Z" for outline in outlines)


def _view_box(box: Box) -> str:
    return f"{box.left - 0.5} {box.top - 0.5} {box.size[0]} {box.size[1]}"


def _xray(grey: GreyArray) -> str:
    """A preview of the X-ray: JPEG, as lossless noise would make the page several times as large."""
    import cv2

    longest = max(grey.shape)
    if longest > _LONGEST_SIDE_PX:
        scale = _LONGEST_SIDE_PX / longest
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, encoded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return _data_uri("image/jpeg", encoded.tobytes())


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def _uv(point: FloatArray) -> tuple[float, float]:
    return round(float(point[0]), 2), round(float(point[1]), 2)


def _vector(values: Sequence[float], digits: int = 3) -> str:
    return f"[{', '.join(f'{value:.{digits}f}' for value in values)}]"


def _matrix(rows: Sequence[Sequence[float]]) -> str:
    """Four rows that Python and JSON read back."""
    texts = [[f"{value:.8f}" for value in row] for row in rows]
    width = max(len(text) for row in texts for text in row)
    lines = [f"[{', '.join(text.rjust(width) for text in row)}]" for row in texts]
    return "[" + ",\n ".join(lines) + "]"
