"""What the detector saw: an X-ray as float32 with metal bright."""

from dataclasses import dataclass
from pathlib import Path

from screwpose._types import ImageArray


@dataclass(frozen=True, eq=False)
class Radiograph:
    """One X-ray image.

    Parameters
    ----------
    pixels : (rows, columns), float32, metal BRIGHT, 0 at the brightest (least attenuated) value of the detector's
        range and 1 at the darkest: ``(white - grey) / (white - black)`` for a metal-dark image.
    metal_bright_in_file : whether the stored greys already had metal bright (nothing was inverted).
    bits : bits of grey that the file holds.
    path : the file, where there is one.
    notes : what a reader should know ("three equal channels read as grey"), for the case's warnings.
    """

    pixels: ImageArray
    metal_bright_in_file: bool = False
    bits: int = 8
    path: Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in px."""
        return self.pixels.shape[1], self.pixels.shape[0]
