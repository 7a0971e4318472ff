"""Stored greys with the range they count in: what every file format is turned into before metal is made bright."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from screwpose.errors import ImageError

NumberArray: TypeAlias = NDArray[Any]
"""Stored numbers of any real type."""

_USUAL_BITS = (8, 10, 12, 14, 16)


@dataclass(frozen=True, eq=False)
class Greys:
    """An image as its file shows it, before anything is said about metal.

    Parameters
    ----------
    values : (rows, columns), any real type.
    black, white : the values that are shown black and white; ``black > white`` where the file stores its greys
        inverted (DICOM's MONOCHROME1, TIFF's "white is zero").
    bits : bits of grey in use.
    notes : what the reader should know.
    metal_bright : whether metal is SHOWN bright, where the file itself says so, else None.
    """

    values: NumberArray
    black: float
    white: float
    bits: int
    notes: tuple[str, ...] = ()
    metal_bright: bool | None = None

    def shown(self) -> NDArray[np.float64]:
        """The image as shown: (rows, columns), 0 black to 1 white."""
        return np.clip((self.values.astype(np.float64) - self.black) / (self.white - self.black), 0.0, 1.0)


def single_channel(array: NumberArray, path: Path) -> tuple[NumberArray, tuple[str, ...]]:
    """Reduce (rows, columns[, channels]) to grey: alpha is dropped and equal colours become one, each with a note.

    Raises
    ------
    ImageError
        The colours differ, or the array has another number of channels or dimensions.
    """
    if array.ndim == 2:
        return array, ()
    if array.ndim != 3 or array.shape[2] not in (1, 2, 3, 4):
        raise ImageError(
            f"its pixels have the shape {array.shape}", file=path, expected="one grey value a pixel (rows, columns)"
        )
    notes: list[str] = []
    if array.shape[2] in (2, 4):
        alpha, array = array[..., -1], array[..., :-1]
        share = float(np.mean(alpha < alpha.max())) if alpha.max() > 0 else 1.0
        hidden = f"; {share:.0%} of the pixels are more transparent than the rest" if share > 0 else ""
        notes.append(f"The transparency channel was left out{hidden}.")
    if array.shape[2] == 3:
        differ = np.any(array != array[..., :1], axis=2)
        if np.any(differ):
            row, column = (int(i) for i in np.argwhere(differ)[0])
            raise ImageError(
                f"it is a colour image: {np.mean(differ):.1%} of its pixels are coloured, the first at column "
                f"{column}, row {row} is {array[row, column].tolist()}",
                file=path,
                expected="a grey image of 8 or 16 bit",
                remedy="Export the X-ray itself as grey, without coloured annotations.",
            )
        notes.append("Three equal colour channels were read as grey.")
    return array[..., 0], tuple(notes)


def grey_range(values: NumberArray, container_bits: int, path: Path) -> tuple[float, float, int, tuple[str, ...]]:
    """The range (black, white) in which `values` count, the bits in use, and notes.

    Detectors give 10 to 14 bits in containers of 16: white is then not the container's largest number, and inverting
    about that would squeeze the image into a corner of [0, 1]. The range is the smallest usual one that holds all
    values. Floating point, 32-bit and negative numbers have no such range: floats inside [0, 1] count as they are,
    the others from their smallest to their largest.
    """
    low, high = float(values.min()), float(values.max())
    if not np.isfinite(low) or not np.isfinite(high):
        bad = int(np.size(values) - np.isfinite(values).sum())
        raise ImageError(
            f"{bad} of its pixels are not finite numbers",
            file=path,
            expected="finite greys",
            remedy="Replace them by the grey of their neighbours and mark them in the view's mask.",
        )
    if values.dtype.kind == "f":
        if low >= 0.0 and high <= 1.0:
            return 0.0, 1.0, container_bits, ()
        return low, high, container_bits, (f"Floating-point greys were scaled from their range {low:g} to {high:g}.",)
    bits = next((b for b in _USUAL_BITS if high < 2**b), None)
    if low < 0 or bits is None:
        return low, high, container_bits, (f"Greys were scaled from their range {low:g} to {high:g}.",)
    bits = min(bits, container_bits)
    notes: tuple[str, ...] = ()
    if bits < container_bits:
        notes = (f"The brightest value is {high:.0f}: the {container_bits}-bit greys were read as {bits} bit.",)
    return 0.0, float(2**bits - 1), bits, notes


def refuse_one_value(values: NumberArray, path: Path) -> None:
    """Refuse an image in which nothing can be seen."""
    low, high = values.min(), values.max()
    if low == high:
        kind = " (all-black image)" if low == 0 else ""
        raise ImageError(
            f"all {values.shape[1]} x {values.shape[0]} pixels have the value {low:g}{kind}",
            file=path,
            expected="an X-ray with contrast",
            remedy="Export the image again; a multi-page file may hold the X-ray in another frame.",
        )
