"""What do the simulator's patients look like? AP and LAT of each kind, with two screws, in one picture.

    SCREWPOSE_DATA=... python -m benchmarks.picture_anatomy --out docs/images/simulated-anatomy.jpg

Rows: two parametric patients, the segmented spine, the CT; then a parametric one with clutter.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from screwpose._types import FloatArray
from screwpose.files.atomic import write_bytes
from screwpose.geometry.rigid import rotation_between
from screwpose.implants.design import ScrewDesign
from screwpose.implants.parametric import make_screw
from screwpose.simulation import CArm, carm_camera, render
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.detector_presets import flat_panel
from screwpose.simulation.instruments import keep_out_of, random_clutter
from screwpose.simulation.materials import TITANIUM
from screwpose.simulation.patient import Level, Patient, ct_patient, mesh_spine_patient, parametric_patient
from tests.data import data_folder

_SIZE = (640, 640)
_SHOWN = 420
_VIEWS = {"AP": (0.0, 1.0, 0.0), "LAT": (1.0, 0.0, 0.0)}
_LEVEL = 2


def screw_pose(level: Level, side: int, rng: np.random.Generator, length_mm: float) -> FloatArray:
    """Through a pedicle, converging: (4, 4)."""
    convergence, tilt = np.radians(rng.uniform(10.0, 20.0)) * (1.0, -1.0)[side], np.radians(rng.normal(0.0, 4.0))
    out = np.array([np.sin(convergence), np.cos(convergence) * np.cos(tilt), np.sin(tilt)])
    pose = np.eye(4)
    pose[:3, :3] = rotation_between(np.array([0.0, 1.0, 0.0]), out / np.linalg.norm(out))
    pose[:3, 3] = level.pedicles_mm[side] - 0.55 * length_mm * out
    return np.asarray(level.world_from_level @ pose)


def views(patient: Patient, seed: int, clutter: int) -> list[NDArray[np.uint8]]:
    """AP and LAT of two screws in the third lowest level."""
    rng = np.random.default_rng([seed, 1])
    design = ScrewDesign()
    implant = make_screw(design, "s")
    level = patient.levels[_LEVEL]
    poses = [screw_pose(level, side, rng, design.shank_length_mm) for side in (0, 1)]
    screws = [Body(implant.mesh, TITANIUM, pose, layer=Layer.IMPLANT) for pose in poses]
    bodies = patient.bodies(rng)
    keep_out = [keep_out_of(implant, pose) for pose in poses]
    others = random_clutter(rng, keep_out, clutter, levels=patient.levels[1:5], back_mm=patient.back_mm)
    middle = level.world_from_level[:3, 3] + [0.0, 40.0, 8.0]
    carm = CArm(pixel_mm=307.2 / _SIZE[0], image_size=_SIZE)
    images = []
    for beam in _VIEWS.values():
        camera = carm_camera(carm, middle, np.array(beam), np.array([0.0, 0.0, -1.0]))
        machine = replace(flat_panel(_SIZE, 307.2 / _SIZE[0]), bits=8)
        shown = render(camera, [*bodies, *others, *screws], machine, rng, volume=patient.volume)
        images.append(shown.pixels.astype(np.uint8))
    return images


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="the picture")
    out: Path = parser.parse_args().out
    data = data_folder()
    made: list[tuple[Callable[[np.random.Generator], Patient], int, int]] = [
        (parametric_patient, 3, 0),
        (parametric_patient, 8, 0),
        (lambda rng: mesh_spine_patient(data / "anatomy" / "P001", rng), 1, 0),
        (lambda rng: ct_patient(data / "ct" / "example_ct.nii.gz", rng), 1, 0),
        (parametric_patient, 12, 5),
        (lambda rng: mesh_spine_patient(data / "anatomy" / "P001", rng), 4, 4),
    ]
    pairs = []
    for build, seed, clutter in made:
        pair = np.hstack(views(build(np.random.default_rng(seed)), seed, clutter))
        pairs.append(cv2.resize(pair, (2 * _SHOWN, _SHOWN), interpolation=cv2.INTER_AREA))
    grid = np.vstack([np.hstack(pairs[k : k + 2]) for k in range(0, len(pairs), 2)])
    _, jpeg = cv2.imencode(".jpg", grid, [cv2.IMWRITE_JPEG_QUALITY, 80])
    write_bytes(out, jpeg.tobytes())
    Console().print(f"{out}: {grid.shape[1]} x {grid.shape[0]} px, {len(jpeg) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
