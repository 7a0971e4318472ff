"""X-rays and masks from files: one door for PNG, TIFF and DICOM."""

from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from screwpose._types import BoolArray
from screwpose.errors import ImageError
from screwpose.images.dicom import dicom_greys, has_dicom_preamble, looks_like_dicom
from screwpose.images.greys import Greys, refuse_one_value
from screwpose.images.polarity import detect_polarity
from screwpose.images.radiograph import Radiograph
from screwpose.images.raster import PNG_MAGIC, TIFF_MAGICS, decoded_png, png_greys, tiff_greys

PolarityChoice: TypeAlias = Literal["metal-dark", "metal-bright", "auto"]

_FORMATS = "a PNG, TIFF (8 or 16 bit, grey) or DICOM (XA, RF, DX, CR) file"
_OTHER_FORMATS = {
    b"\xff\xd8\xff": "a JPEG file",
    b"BM": "a BMP file",
    b"GIF8": "a GIF file",
    b"\x00\x00\x00\x0cjP": "a JPEG 2000 file",
    b"%PDF": "a PDF file",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a gzip file",
    b"{": "a text file",
}


def read_radiograph(path: str | Path, polarity: PolarityChoice = "auto", frame: int | None = None) -> Radiograph:
    """Read an X-ray and make its metal bright.

    Parameters
    ----------
    path : a PNG, TIFF or DICOM file; told apart by content, not by name.
    polarity : how metal looks when the file is SHOWN as its format says (a DICOM of MONOCHROME1 is shown inverted).
        "auto": what the DICOM itself says (Pixel Intensity Relationship Sign), else what the image looks like; where
        that cannot be decided, metal is taken to be dark, with a note.
    frame : which frame of a file with several, counted from 0. None: the one that a DICOM names as representative,
        else the first, with a note.

    Returns
    -------
    Radiograph, float32, metal bright, in [0, 1] over the range of the detector. A DICOM's rescale is applied, its
    window (VOI) is not.

    Raises
    ------
    ImageError
        Missing, unreadable, coloured, of a single value, not a projection X-ray, or a frame that is not there.
    """
    path = Path(path)
    greys = _read_greys(path, frame)
    refuse_one_value(greys.values, path)
    shown = greys.shown()
    metal_bright, notes = _metal_shown_bright(polarity, greys, shown)
    pixels = shown if metal_bright else 1.0 - shown
    return Radiograph(
        pixels=pixels.astype(np.float32),
        metal_bright_in_file=metal_bright == (greys.white > greys.black),
        bits=greys.bits,
        path=path,
        notes=greys.notes + notes,
    )


def read_mask(path: str | Path, size: tuple[int, int]) -> BoolArray:
    """Read a mask or target: true where the file is not black.

    Parameters
    ----------
    path : a PNG or TIFF of any bit depth; colours count as not black, transparency is left out.
    size : (width, height), px, of the X-ray that it belongs to.

    Raises
    ------
    ImageError
        Unreadable, of another size, or black all over.
    """
    path = Path(path)
    data = _read_bytes(path)
    if data.startswith(PNG_MAGIC):
        mask = _not_black_png(data, path)
    elif data.startswith(TIFF_MAGICS) and not has_dicom_preamble(data):
        mask = np.asarray(tiff_greys(data, path, None).shown() > 0.0)
    else:
        raise ImageError(f"it is {_kind(data)}", file=path, expected="a mask as PNG or TIFF")
    width, height = size
    if mask.shape != (height, width):
        raise ImageError(
            f"the mask is {mask.shape[1]} x {mask.shape[0]} px and its X-ray {width} x {height}",
            file=path,
            expected=f"{width} x {height} px",
            remedy="Make the mask on the X-ray at full size.",
        )
    if not mask.any():
        raise ImageError(
            "the mask is black all over: nothing would count",
            file=path,
            expected="non-zero pixels where the projection counts",
        )
    return mask


def _read_bytes(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise ImageError(
            "there is no such file", file=path, expected=_FORMATS, remedy="Check the path and its spelling."
        ) from error
    except IsADirectoryError as error:
        raise ImageError(
            "it is a folder", file=path, expected=_FORMATS, remedy="Name one file: one X-ray a view."
        ) from error
    except OSError as error:
        raise ImageError(f"it cannot be opened ({error.strerror})", file=path, expected="a readable file") from error
    if not data:
        raise ImageError("the file is empty", file=path, expected=_FORMATS, remedy="Export or copy the file again.")
    return data


def _read_greys(path: Path, frame: int | None) -> Greys:
    data = _read_bytes(path)
    if has_dicom_preamble(data):
        return dicom_greys(data, path, frame)
    if data.startswith(PNG_MAGIC):
        return png_greys(data, path, frame)
    if data.startswith(TIFF_MAGICS):
        return tiff_greys(data, path, frame)
    if looks_like_dicom(data):
        return dicom_greys(data, path, frame)
    raise ImageError(
        f"it is {_kind(data)}",
        file=path,
        expected=_FORMATS,
        remedy="Export the X-ray in one of these formats, without lossy compression.",
    )


def _kind(data: bytes) -> str:
    if looks_like_dicom(data):
        return "a DICOM file"
    return next((name for magic, name in _OTHER_FORMATS.items() if data.startswith(magic)), "of no known image format")


def _metal_shown_bright(polarity: PolarityChoice, greys: Greys, shown: np.ndarray) -> tuple[bool, tuple[str, ...]]:
    """Whether metal is bright as shown, and notes for what was not certain."""
    if polarity != "auto":
        return polarity == "metal-bright", ()
    guess = detect_polarity(shown.astype(np.float32))
    if greys.metal_bright is None:
        if guess.decided:
            return guess.polarity == "metal-bright", ()
        return False, (
            "Whether metal is dark or bright could not be told from the image: metal-dark was assumed. "
            "Set the view's polarity.",
        )
    stated = "metal-bright" if greys.metal_bright else "metal-dark"
    if guess.decided and guess.polarity != stated:
        return greys.metal_bright, (
            f"The DICOM says {stated} (Pixel Intensity Relationship Sign), the image looks {guess.polarity}: the DICOM "
            "was believed. Set the view's polarity if that is wrong.",
        )
    return greys.metal_bright, ()


def _not_black_png(data: bytes, path: Path) -> BoolArray:
    array = decoded_png(data, path)
    if array.ndim == 3:
        array = array[..., : 1 if array.shape[2] <= 2 else 3].max(axis=2)
    return np.asarray(array != 0)
