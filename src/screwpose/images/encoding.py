"""Images to the bytes of a PNG file."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def encode_png(pixels: NDArray[Any]) -> bytes:
    """The bytes of a lossless PNG.

    Parameters
    ----------
    pixels : (rows, columns) grey, (rows, columns, 3) RGB or (rows, columns, 4) RGBA, uint8 or uint16; a mask (bool)
        becomes 0 and 255.

    Raises
    ------
    ValueError
        Another type or shape: a fault of the caller, not of the input.
    """
    import imagecodecs

    if pixels.dtype == np.bool_:
        pixels = pixels.astype(np.uint8) * np.uint8(255)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"PNG holds uint8 or uint16, not {pixels.dtype}")
    if pixels.size == 0 or not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (3, 4))):
        raise ValueError(f"PNG holds (rows, columns) or (rows, columns, 3 or 4), not {pixels.shape}")
    return bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels)))
