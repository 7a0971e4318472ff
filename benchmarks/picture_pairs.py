"""Could these be fluoroscopy? AP and LAT of a case of each of six sets, next to each other.

    SCREWPOSE_DATA=... python -m benchmarks.picture_pairs --out docs/images/simulated-six-pairs.jpg

Two cases a row, each AP beside its LAT. The cases are taken as the sets make them; nothing is retouched. All sets show
metal dark; `--bright` turns the greys of some of them round, as a monitor's switch does.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from screwpose.benchmark.sets import get_set
from screwpose.files import read_case
from screwpose.files.atomic import write_bytes

_SETS = "paper,pairs,multi,clutter,tilted,other"
_BRIGHT = "tilted"
_VIEWS = ("AP", "LAT")
_ACROSS = 2
_GAP_PX = 6
_PAPER_WHITE = 255


def pair_of(set_name: str, seed: int, index: int, size_px: int, is_bright: bool) -> tuple[NDArray[np.uint8], str]:
    """AP beside LAT as they would be shown, and what the case is."""
    with TemporaryDirectory() as folder:
        path = get_set(set_name).make(seed, index, Path(folder))
        views = read_case(path).views
        scene = json.loads((path.parent / "scene.json").read_text(encoding="utf-8"))
        bright = [np.rint(255.0 * views[name].radiograph.pixels).astype(np.uint8) for name in _VIEWS]
    shown = bright if is_bright else [255 - image for image in bright]
    small = [cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA) for image in shown]
    gap = np.full((size_px, _GAP_PX // 3), _PAPER_WHITE, np.uint8)
    detector = scene["detector"]
    field = "flat panel" if detector["field_radius_px"] is None else "image intensifier"
    words = f"{set_name}: {len(scene['screws'])} screws, {field}, {detector['display']} display"
    return np.hstack([small[0], gap, small[1]]), words


def grid_of(pairs: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """The pairs, two a row, on white."""
    height, width = pairs[0].shape
    rows = -(-len(pairs) // _ACROSS)
    shape = (rows * (height + _GAP_PX) - _GAP_PX, _ACROSS * (width + 2 * _GAP_PX) - 2 * _GAP_PX)
    grid = np.full(shape, _PAPER_WHITE, np.uint8)
    for number, pair in enumerate(pairs):
        top, left = (number // _ACROSS) * (height + _GAP_PX), (number % _ACROSS) * (width + 2 * _GAP_PX)
        grid[top : top + height, left : left + width] = pair
    return grid


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", default=_SETS, help="with commas")
    parser.add_argument("--bright", default=_BRIGHT, help="those of them that are shown with bright metal")
    parser.add_argument("--seed", type=int, default=3, help="of development: below 1000")
    parser.add_argument("--index", type=int, default=0, help="of the case in each set")
    parser.add_argument("--size", type=int, default=480, help="px of each view in the picture")
    parser.add_argument("--quality", type=int, default=78, help="of the JPEG")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    if not 0 <= asked.seed < 1000:
        parser.error("--seed: reporting's seeds are not looked at: below 1000")
    pairs = []
    for name in asked.sets.split(","):
        pair, words = pair_of(name, asked.seed, asked.index, asked.size, name in asked.bright.split(","))
        Console().print(words)
        pairs.append(pair)
    grid = grid_of(pairs)
    _, jpeg = cv2.imencode(".jpg", grid, [cv2.IMWRITE_JPEG_QUALITY, asked.quality])
    write_bytes(asked.out, jpeg.tobytes())
    Console().print(f"{asked.out}: {grid.shape[1]} x {grid.shape[0]} px, {len(jpeg) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
