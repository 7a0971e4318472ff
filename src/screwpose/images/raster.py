"""PNG and TIFF to greys.

Both are decoded by imagecodecs (TIFF through tifffile): it keeps 16 bit and the order of the channels, and a
truncated or damaged file raises an error that says why. OpenCV's decoder returns None and prints to the terminal.
"""

import io
import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.errors import ImageError
from screwpose.images.greys import Greys, NumberArray, grey_range, single_channel

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
TIFF_MAGICS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")

# Mark, header, one empty data chunk and the end: below that the decoder reports whatever its memory holds.
_LEAST_PNG_BYTES = 8 + 25 + 12 + 12
_MINISWHITE, _PALETTE = 0, 3
_RE_EXPORT = "Export or copy the file again."


def png_greys(data: bytes, path: Path, frame: int | None) -> Greys:
    """Decode a PNG; palettes come out as colours, transparency is left out.

    Raises
    ------
    ImageError
        Damaged, coloured, or another frame than 0 asked for.
    """
    refuse_absent_frame(frame, 1, path)
    array = decoded_png(data, path)
    values, notes = single_channel(array, path)
    black, white, bits, more = grey_range(values, 8 * values.itemsize, path)
    return Greys(values, black, white, bits, notes + more)


def decoded_png(data: bytes, path: Path) -> NumberArray:
    """The pixels of a PNG: (rows, columns[, channels]); palettes are looked up.

    Raises
    ------
    ImageError
        Damaged.
    """
    import imagecodecs

    try:
        if len(data) < _LEAST_PNG_BYTES:
            raise ValueError("it ends too early")
        return np.asarray(imagecodecs.png_decode(data))
    except (imagecodecs.PngError, ValueError, MemoryError) as error:
        reason = str(error) or "it does not fit into memory"
        raise ImageError(
            f"it cannot be decoded as PNG ({reason})", file=path, expected="a whole PNG file", remedy=_RE_EXPORT
        ) from error


def tiff_greys(data: bytes, path: Path, frame: int | None) -> Greys:
    """Decode one page of a TIFF; reduced copies (thumbnails) and transparency masks do not count as pages.

    Raises
    ------
    ImageError
        Damaged, coloured, without an image, a volume, or a frame that it does not have.
    """
    import tifffile

    # Without a handler the library's complaints about a damaged file would go to the terminal beside our error.
    logging.getLogger("tifffile").addHandler(logging.NullHandler())
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            pages = [page for page in file.pages if not _is_side_image(page)]
            if not pages:
                raise ImageError(
                    "this TIFF holds no image, or is cut off",
                    file=path,
                    expected="at least one page",
                    remedy=_RE_EXPORT,
                )
            index = refuse_absent_frame(frame, len(pages), path)
            page: Any = pages[index]
            if page.imagedepth > 1:
                raise ImageError(
                    f"its page is a volume of {page.imagedepth} slices", file=path, expected="one X-ray a page"
                )
            array = np.asarray(page.asarray())
            if page.photometric == _PALETTE:
                array = np.moveaxis(np.asarray(page.colormap)[:, array], 0, -1)
            if page.axes.startswith("S") and array.ndim == 3:
                array = np.moveaxis(array, 0, -1)
            inverted = page.photometric == _MINISWHITE
            container_bits = int(page.bitspersample) if page.photometric != _PALETTE else 16
            orientation = page.tags.valueof(274, default=1)
    except (ValueError, RuntimeError, OSError, KeyError, IndexError, TypeError, struct.error) as error:
        raise ImageError(
            f"it cannot be decoded as TIFF ({error})",
            file=path,
            expected="a whole TIFF file of 8 or 16 bit grey",
            remedy=_RE_EXPORT,
        ) from error
    notes = first_frame_notes(frame, index, len(pages))
    if orientation != 1:
        notes += (f"The TIFF's orientation tag ({int(orientation)}) was ignored: pixels are taken as they are stored.",)
    values, channel_notes = single_channel(array, path)
    if values.dtype == np.bool_:
        values = values.astype(np.uint8)
    more: tuple[str, ...] = ()
    black, white, bits = 0.0, float(2**container_bits - 1), container_bits
    if container_bits >= 8:
        black, white, bits, more = grey_range(values, container_bits, path)
    if inverted:
        black, white = white, black
    return Greys(values, black, white, bits, notes + channel_notes + more)


def refuse_absent_frame(frame: int | None, count: int, path: Path, representative: int = 0) -> int:
    """The frame to read, counted from 0: the one asked for, else `representative`."""
    if frame is None:
        return representative
    if not 0 <= frame < count:
        raise ImageError(
            f"frame {frame} was asked for, and the file has {count}",
            file=path,
            field="frame",
            expected=f"0 to {count - 1} (frames are counted from 0)",
        )
    return frame


def first_frame_notes(frame: int | None, index: int, count: int, why: str = "the first") -> tuple[str, ...]:
    """The loud note where one of several frames was taken without being asked for."""
    if frame is not None or count == 1:
        return ()
    return (
        f"The file has {count} frames and none was chosen: frame {index} (counted from 0, {why}) was read. "
        "Save the frame that belongs to the calibration as a file of its own if it is another.",
    )


def _is_side_image(page: Any) -> bool:
    return bool(page.is_reduced or page.is_mask)
