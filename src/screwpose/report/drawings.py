"""Every shadow that the report draws, cast once and used by the PNG files and by the page."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from screwpose.files.case import Case
from screwpose.files.result import PosedImplant, Result
from screwpose.report.comparison import Comparison
from screwpose.report.overlays import Box, crop_around, whole_image
from screwpose.report.palette import Palette
from screwpose.report.shadows import Shadow, cast_shadows
from screwpose.report.tables import chosen_combination

# Twelve screws can be paired in 12! ways, of which some are scored; nobody looks at pictures past the best few.
MAX_COMBINATIONS_DRAWN = 4
STAGES = ("pre", "post")


@dataclass(frozen=True, eq=False)
class Drawings:
    """What the pictures show.

    Parameters
    ----------
    combinations : ids of the drawn ones: the chosen one first, then the best of the others.
    chosen : the id of the chosen one, None where the answer was refused.
    left_out : how many scored ones are not drawn.
    shadows : by (combination, stage, view).
    truth : the true implants' shadows by view, where the truth is known.
    crops : by view, the part that holds the landmarks and the chosen (else the drawn) implants; without any, all of it.
    """

    combinations: tuple[int, ...]
    chosen: int | None
    left_out: int
    shadows: Mapping[tuple[int, str, str], tuple[Shadow, ...]]
    truth: Mapping[str, tuple[Shadow, ...]]
    crops: Mapping[str, Box]

    def panels_of(self, combination: int) -> dict[tuple[str, str], tuple[Shadow, ...]]:
        """The shadows of one combination by (stage, view)."""
        return {(stage, view): cast for (number, stage, view), cast in self.shadows.items() if number == combination}


def draw(case: Case, result: Result, palette: Palette, comparison: Comparison | None = None) -> Drawings:
    """Cast all shadows of the best combinations in all views."""
    chosen = chosen_combination(result.answer)
    chosen_id = None if chosen is None else chosen.id
    scenes = sorted(result.scenes, key=lambda scene: scene.id != chosen_id)[:MAX_COMBINATIONS_DRAWN]
    shadows = {
        (number, stage, name): cast_shadows(view, posed, case.implants, palette)
        for number, stage, posed in stages_of(result, tuple(scene.id for scene in scenes))
        for name, view in case.views.items()
    }
    true_implants = () if comparison is None else comparison.true_implants
    truth = {name: cast_shadows(view, true_implants, case.implants, palette) for name, view in case.views.items()}
    crops = {}
    for name, view in case.views.items():
        # A rejected combination may lie anywhere; the picture is about where the screws are.
        decisive = [
            one
            for (number, _, view_name), cast in shadows.items()
            if view_name == name and (chosen_id is None or number == chosen_id)
            for one in cast
        ]
        clicks = case.annotations.get(name, ())
        crops[name] = crop_around(view, decisive, clicks) if decisive else whole_image(view)
    return Drawings(
        tuple(scene.id for scene in scenes), chosen_id, len(result.scenes) - len(scenes), shadows, truth, crops
    )


def stages_of(result: Result, combinations: tuple[int, ...]) -> Iterator[tuple[int, str, tuple[PosedImplant, ...]]]:
    """(combination, stage, implants) of the named combinations in their order, without stages that hold no implants."""
    scenes = {scene.id: scene for scene in result.scenes}
    for number in combinations:
        for stage, posed in zip(STAGES, (scenes[number].pre, scenes[number].post), strict=True):
            if posed:
                yield number, stage, posed
