"""A small good case on disk, for tests of the program to spoil in one respect at a time."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np

from screwpose.implants.mesh import read_mesh, write_stl
from screwpose.implants.model import Mesh

# The tests' images are a quarter of the usual size: marks are as exact as 2 px of 1024.
SIGMA = ["--landmark-sigma", "0.5"]
QUICK = [*SIGMA, "--generations", "1", "--population", "1", "--faces", "60"]
MODEL = "ms55x50"


class CaseFolder:
    """A case's folder and the content of its case.json; `save` writes the content back."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.data: Any = json.loads((folder / "case.json").read_text())

    @classmethod
    def copied(cls, good: Path, folder: Path) -> "CaseFolder":
        shutil.copytree(good, folder)
        return cls(folder)

    @property
    def model(self) -> dict[str, Any]:
        return self.data["models"][MODEL]

    @property
    def mesh_file(self) -> Path:
        return self.folder / self.model["mesh"]

    def view(self, name: str) -> dict[str, Any]:
        return self.data["views"][name]

    def matrix(self, name: str) -> np.ndarray:
        return np.array(self.view(name)["projection"])

    def set_matrix(self, name: str, matrix: np.ndarray) -> None:
        self.view(name)["projection"] = matrix.tolist()

    def marks(self, view: str) -> list[dict[str, Any]]:
        return self.data["annotations"][view]

    def pixels(self, name: str = "AP") -> np.ndarray:
        return np.asarray(imagecodecs.png_decode((self.folder / self.view(name)["image"]).read_bytes()))

    def set_pixels(self, pixels: np.ndarray, name: str = "AP") -> None:
        (self.folder / self.view(name)["image"]).write_bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels)))

    def change_mesh(self, change: Callable[[Mesh], Mesh]) -> None:
        write_stl(change(read_mesh(self.mesh_file)), self.mesh_file)

    def save(self) -> None:
        (self.folder / "case.json").write_text(json.dumps(self.data))
