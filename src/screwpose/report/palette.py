"""One colour a screw, the same in every picture, that people with any kind of colour vision can tell apart."""

from collections.abc import Mapping
from dataclasses import dataclass

from screwpose.files.case import Case

# Okabe & Ito (2008), "Color Universal Design", ordered so that the first ones stand out most on a grey X-ray.
_COLORS = ("#E69F00", "#56B4E9", "#CC79A7", "#F0E442", "#009E73", "#D55E00", "#0072B2")
_DASHES = ("solid", "dashed", "dotted")
NEUTRAL = "#D8D8D8"


@dataclass(frozen=True)
class Ink:
    """How a screw is drawn: its colour (``#rrggbb``) and, past seven screws, a line style that tells colours apart."""

    color: str
    dash: str = "solid"

    @property
    def rgb(self) -> tuple[float, float, float]:
        """Red, green, blue, each 0 to 1."""
        red, green, blue = (int(self.color[start : start + 2], 16) / 255 for start in (1, 3, 5))
        return red, green, blue


@dataclass(frozen=True)
class Palette:
    """The inks of a case's screws.

    A screw is known by its label in the first view that shows it, so that it keeps its colour in every combination:
    in a wrong one the colours of the other views change places, which is what the eye should see.
    """

    inks: Mapping[tuple[str, str], Ink]
    views: tuple[str, ...]

    @classmethod
    def of_case(cls, case: Case) -> "Palette":
        """Inks by (view, label), the first view's screws first."""
        keys = [(view, annotation.label) for view in case.views for annotation in case.annotations.get(view, ())]
        return cls({key: ink_of(index) for index, key in enumerate(dict.fromkeys(keys))}, tuple(case.views))

    def ink(self, labels: Mapping[str, str]) -> Ink:
        """The ink of a screw with these labels by view; neutral where no view of the case knows it."""
        for view in self.views:
            if view in labels and (view, labels[view]) in self.inks:
                return self.inks[view, labels[view]]
        return Ink(NEUTRAL)


def ink_of(index: int) -> Ink:
    """The ink of the screw that comes so far down the list of a case's marks."""
    return Ink(_COLORS[index % len(_COLORS)], _DASHES[index // len(_COLORS) % len(_DASHES)])


def screw_name(labels: Mapping[str, str]) -> str:
    """A screw in words, ``AP 1 / LAT b``."""
    return " / ".join(f"{view} {label}" for view, label in labels.items())
