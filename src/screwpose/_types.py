"""Array types; shapes, units and frames stand in the docstrings."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
ImageArray: TypeAlias = NDArray[np.float32]
"""An image: float32, (rows, columns), metal bright."""
BoolArray: TypeAlias = NDArray[np.bool_]
"""A mask: bool, (rows, columns)."""
IntArray: TypeAlias = NDArray[np.int64]
