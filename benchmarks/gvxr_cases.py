"""Cases whose X-rays another simulator made: is our accuracy that of our own simulator's images alone?

    SCREWPOSE_DATA=../shared/data python -m benchmarks.gvxr_cases --count 20 --seed 1 -o gvxr-cases
    screwpose bench --cases gvxr-cases --method paper,default -o gvxr-out

gVXR (see docs/simulation.md for how to install it) traces two screws with towers among the vertebrae of P001 in a body
of water, with its own attenuation and over bins of 4 keV; what follows, scatter, blur, noise and a logarithmic display
of 12 bits, is a few lines of this script and shares nothing with `screwpose.simulation.detector`. Only the arrangement,
the cameras and the marks are planned as in the set `pairs`. Metal, bone and water add up where they overlap. `--bare`
leaves the patient away. Writes one case folder a case, with its truth.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console
from rich.progress import track
from scipy import ndimage

from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Mesh
from screwpose.simulation.imperfections import Imperfections
from screwpose.simulation.scenes import ScenePlan, SimulatedCase, SimulatedView, plan_scene
from screwpose.simulation.scenes_options import SceneOptions
from screwpose.simulation.spectra import signal_spectrum, xray_tables
from screwpose.simulation.writing import write_case
from screwpose.simulation.xray import SimulatedXray
from tests.data import data_folder
from tests.validation.gvxr_reference import Piece, gvxr_image, loaded_gvxr

TITANIUM, BONE, WATER = {22: 0.90, 13: 0.06, 23: 0.04}, {1: 0.07, 8: 0.63, 20: 0.20, 15: 0.10}, {1: 0.112, 8: 0.888}
SCENE = SceneOptions(
    lengths_mm=(30.0, 60.0),
    diameters_mm=(4.5, 8.5),
    designs=(1, 2),
    tower_length_mm=(60.0, 130.0),
    angle_deg=(60.0, 120.0),
    overlap_lat=(0.0, 1.0),
    round_field=0.0,
)
_KEV = 4  # bins of the spectrum that are taken together
_PHOTONS = 800.0  # a pixel, behind the patient: what the automatic exposure sees to
_BITS = 12


def pieces_of(plan: ScenePlan, folder: Path, is_bare: bool) -> list[Piece]:
    """Screws, and the patient about them: in LPS, the skin 45 mm behind the screws' heads."""
    screws = []
    for screw in plan.screws:
        mesh = screw.implant.mesh
        screws.append(Mesh(rigid.transform(screw.world_from_cad, mesh.vertices_mm), mesh.faces))
    pieces = [Piece(mesh, TITANIUM, 4.43) for mesh in screws]
    if is_bare:
        return pieces
    tips = np.stack([rigid.transform(s.world_from_cad, s.implant.tip_mm) for s in plan.screws])
    heads = np.stack(
        [rigid.transform(s.world_from_cad, 2 * s.implant.center_mm - s.implant.tip_mm) for s in plan.screws]
    )
    middle = 0.5 * (tips.mean(axis=0) + heads.mean(axis=0))
    bones = [trimesh.load_mesh(path) for path in sorted((folder / "anatomy" / "P001").glob("*.stl"))]
    nearest = bones[5].vertices.mean(axis=0)  # the middle one of eleven
    pieces += [
        Piece(Mesh(np.asarray(bone.vertices - nearest + middle), np.asarray(bone.faces)), BONE, 1.35) for bone in bones
    ]
    body = trimesh.creation.icosphere(subdivisions=5)
    half_mm = np.array([150.0, 105.0, 260.0])
    center = middle + [0.0, heads[:, 1].mean() + 45.0 - middle[1] - half_mm[1], 0.0]
    pieces.append(Piece(Mesh(np.asarray(body.vertices * half_mm + center), np.asarray(body.faces)), WATER, 1.02))
    return pieces


def displayed(transmission: FloatArray, rng: np.random.Generator) -> Any:
    """Exposure, scatter, blur, noise and a logarithmic display, 12 bits in 16, metal dark."""
    rows, columns = transmission.shape
    through = float(np.median(transmission[rows // 3 : -rows // 3, columns // 3 : -columns // 3]))
    scatter = 0.5 * ndimage.gaussian_filter(np.minimum(transmission, 20.0 * through), 50.0)
    arrived = ndimage.gaussian_filter(transmission + scatter, 0.7) * _PHOTONS / through
    counts = rng.poisson(arrived) + rng.normal(0.0, 2.0, arrived.shape)
    log = np.log(np.maximum(counts, 1.0))
    black, white = np.percentile(log, 0.1) - 0.2, min(np.percentile(log, 99.0), np.log(30.0 * _PHOTONS))
    grey = np.clip((log - black) / (white - black), 0.0, 1.0)
    return np.round(grey * (2**_BITS - 1)).astype(np.uint16) * np.uint16(2 ** (16 - _BITS))


def made(gvxr: Any, plan: ScenePlan, folder: Path, is_bare: bool) -> SimulatedCase:
    """The planned case with gVXR's images."""
    signal, energies = signal_spectrum(plan.detector.peak_kv), xray_tables().energy_kev
    first = np.arange(0, len(signal), _KEV)
    shares = np.add.reduceat(signal, first)
    middles = np.add.reduceat(signal * energies, first) / np.maximum(shares, 1e-12)
    pieces = pieces_of(plan, folder, is_bare)
    views = {}
    for number, (name, camera) in enumerate(plan.true_cameras.items()):
        sized = Camera.from_matrix(camera.projection, plan.options.image_size)
        transmission = gvxr_image(gvxr, sized, pieces, middles, shares)
        rng = np.random.default_rng([plan.seed, number, 77])
        views[name] = SimulatedView(
            plan.cameras[name], SimulatedXray(displayed(transmission, rng), transmission), camera
        )
    parts = tuple(screw.part_poses for screw in plan.screws)
    return SimulatedCase(
        plan.id, plan.seed, views, plan.implants, plan.annotations, plan.posed, parts, plan.overlap, plan
    )


def main() -> None:
    """Make the cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the case folders")
    parser.add_argument("--count", type=int, default=10, help="how many cases")
    parser.add_argument("--seed", type=int, default=1, help="development seeds are below 1000")
    parser.add_argument("--noise", type=float, default=1.5, help="of the marks, px")
    parser.add_argument("--bare", action="store_true", help="metal in air")
    given = parser.parse_args()
    console = Console()
    try:
        gvxr = loaded_gvxr()
    except ImportError as error:
        raise SystemExit(f"gVXR is absent ({error}): see docs/simulation.md") from error
    for index in track(range(given.count), console=Console(stderr=True)):
        seed = int(np.random.SeedSequence([given.seed, index, 4021]).generate_state(1)[0])
        plan = plan_scene(
            SCENE, Imperfections(landmark_noise_px=given.noise), seed, case_id=f"gvxr-{given.seed}-{index}"
        )
        write_case(made(gvxr, plan, data_folder(), given.bare), given.out / f"{index:03d}")
    console.print(f"{given.count} cases in {given.out}")


if __name__ == "__main__":
    main()
