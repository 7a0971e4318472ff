"""A small case on disk, right in every respect, for tests to spoil in one respect at a time.

Two cameras 800 mm from the world's origin: AP looks along +z, LAT along +x. Focal length 200 px, images of 64 x 64 px.
One screw, a box of 6 x 45 x 6 mm along +y in its CAD frame, stands at the origin of the world.
"""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.files import write_bytes, write_json, write_text
from screwpose.images.encoding import encode_png

SIZE = 64
K = np.array([[200.0, 0.0, 31.5], [0.0, 200.0, 31.5], [0.0, 0.0, 1.0]])
_TO_SOURCE = [0.0, 0.0, 800.0]
# Rows are the camera's axes in the world: u, v, depth.
AP = K @ np.column_stack([np.eye(3), _TO_SOURCE])
LAT = K @ np.column_stack([[[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], _TO_SOURCE])
TIP_MM, CENTER_MM = [0.0, 0.0, 0.0], [0.0, 22.5, 0.0]


class CaseBuilder:
    """The content of a case; `write` puts it on disk with its files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.data: dict[str, Any] = {
            "format": "screwpose-case/1",
            "id": "box",
            "views": {
                "AP": {"image": "ap.png", "projection": AP.tolist(), "polarity": "metal-dark"},
                "LAT": {"image": "lat.png", "projection": LAT.tolist(), "polarity": "metal-dark"},
            },
            "models": {"box": {"mesh": "models/box.stl", "unit": "mm", "tip": TIP_MM, "center": CENTER_MM}},
            # Worked by hand: the tip is on both axes, the centre 22.5 mm below it at 800 mm: 22.5 * 200 / 800 = 5.625.
            "annotations": {
                "AP": [{"label": "1", "tip": [31.5, 31.5], "center": [31.5, 37.125], "model": "box"}],
                "LAT": [{"label": "a", "tip": [31.5, 31.5], "center": [31.5, 37.125]}],
            },
        }
        self.images = {"ap.png": xray(seed=1), "lat.png": xray(seed=2)}
        self.meshes = {"models/box.stl": box_stl([-3, 0, -3], [3, 45, 3])}

    @property
    def file(self) -> Path:
        return self.folder / "case.json"

    def write(self) -> Path:
        """Write everything; returns the case file."""
        (self.folder / "models").mkdir(parents=True, exist_ok=True)
        for name, pixels in self.images.items():
            write_bytes(self.folder / name, encode_png(pixels))
        for name, text in self.meshes.items():
            write_text(self.folder / name, text)
        return write_json(self.file, self.data)

    def write_raw(self, text: str) -> Path:
        """Write the case file as it is given, beside good images and meshes."""
        self.write()
        self.file.write_text(text)
        return self.file

    def text(self) -> str:
        return json.dumps(self.data)

    def view(self, name: str) -> dict[str, Any]:
        return self.data["views"][name]

    def screw(self, view: str, index: int = 0) -> dict[str, Any]:
        return self.data["annotations"][view][index]

    def add_screw(self, view: str, **changes: Any) -> None:
        """Add another screw, 10 px to the right of the first."""
        screw = copy.deepcopy(self.screw(view))
        screw["tip"][0] += 10.0
        screw["center"][0] += 10.0
        self.data["annotations"][view].append({**screw, "label": f"{screw['label']}+", **changes})


def xray(seed: int, size: int = SIZE) -> np.ndarray:
    """A grey background with noise and a dark screw upright in it, uint8."""
    pixels = np.random.default_rng(seed).normal(150.0, 3.0, (size, size))
    middle = size // 2
    pixels[middle : middle + 12, middle - 1 : middle + 1] = 20.0
    return pixels.round().astype(np.uint8)


def box_stl(low: list[float], high: list[float]) -> str:
    """A closed box as ASCII STL, normals outwards."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    facets = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    lines = ["solid box"]
    for facet in facets:
        lines.append("facet normal 0 0 0\nouter loop")
        lines += ["vertex {} {} {}".format(*corners[i]) for i in facet]
        lines.append("endloop\nendfacet")
    return "\n".join([*lines, "endsolid box\n"])
