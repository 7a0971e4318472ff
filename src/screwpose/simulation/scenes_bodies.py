"""What stands in the beam of a scene: patient, metal, clutter, needles; and the detector behind it."""

from collections.abc import Mapping, Sequence

import numpy as np

from screwpose._types import BoolArray
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import transform
from screwpose.implants.model import Mesh
from screwpose.simulation.arrangement_overlap import silhouette
from screwpose.simulation.arrangement_screws import PlacedScrew
from screwpose.simulation.carm import resized
from screwpose.simulation.detector import Detector
from screwpose.simulation.materials import COBALT_CHROME, STEEL, TITANIUM, Material
from screwpose.simulation.patient import Patient
from screwpose.simulation.scenes_options import SceneOptions
from screwpose.simulation.streams import stream
from screwpose.simulation.volume import CtVolume
from screwpose.simulation.xray import Body, Layer

RIM = 6.0 / 1024  # a round field ends this far within the shorter side, as a share of it
_NEEDLE_ANGLES_RAD = np.arange(12) * (np.pi / 6.0)  # round a tower
_QUANTA_PER_NGY = 30.2 * 0.63  # that a mm^2 counts, behind a patient
_NEAR_MM = 75.0  # from a screw's tip: levels at which instruments are put


def bodies_of_scene(
    patient: Patient | None, screws: Sequence[PlacedScrew], options: SceneOptions, seed: int
) -> tuple[list[Body], CtVolume | None]:
    """All that is in the beam at the time of AP, and the CT volume behind it where the patient is one.

    Parameters
    ----------
    patient : None: metal in air.
    """
    tissues = [] if patient is None else patient.bodies(stream(seed, "tissues"))
    metal = metal_of(seed)
    implants = [
        Body(mesh, metal, world_from_body=pose, layer=Layer.IMPLANT) for screw in screws for mesh, pose in screw.pieces
    ]
    volume = None if patient is None else patient.volume
    return [*tissues, *clutter_bodies(patient, screws, clutter_count(options, seed), seed), *implants], volume


def metal_of(seed: int) -> Material:
    """What screws and towers are made of, all of one metal. Steel and cobalt-chrome let next to nothing through."""
    return [TITANIUM, TITANIUM, COBALT_CHROME, STEEL][int(stream(seed, "metal").integers(4))]


def clutter_count(options: SceneOptions, seed: int) -> int:
    """How many pieces of other metal there are."""
    return int(stream(seed, "clutter count").integers(options.clutter[0], options.clutter[1] + 1))


def clutter_bodies(patient: Patient | None, screws: Sequence[PlacedScrew], count: int, seed: int) -> list[Body]:
    """Instruments that the screws do not touch."""
    if count == 0:
        return []
    from screwpose.simulation.instruments import random_clutter

    keep_out = [Mesh(transform(pose, mesh.vertices_mm), mesh.faces) for screw in screws for mesh, pose in screw.pieces]
    if patient is None:
        return random_clutter(stream(seed, "clutter"), keep_out, count)
    tips = [screw.landmarks_in_world_mm[0] for screw in screws]
    in_view = [
        level
        for level in patient.levels
        if min(np.linalg.norm(level.world_from_level[:3, 3] - tip) for tip in tips) < _NEAR_MM
    ]
    return random_clutter(stream(seed, "clutter"), keep_out, count, levels=in_view or None, back_mm=patient.back_mm)


def needle_bodies(screws: Sequence[PlacedScrew], cameras: Mapping[str, Camera]) -> list[Body]:
    """For each screw a needle along its tower, on the side where both views show the most of it."""
    from screwpose.simulation.needles import needle_along

    hidden = {
        view: np.logical_or.reduce([silhouette(camera, screw) for screw in screws]) for view, camera in cameras.items()
    }
    needles = []
    for screw in screws:
        pose = screw.world_from_cad @ screw.upright_from_tower
        tried = [needle_along(screw.implant, pose, angle_rad=angle) for angle in _NEEDLE_ANGLES_RAD]
        needles.append(max(tried, key=lambda needle: min(_seen_of(needle, cameras[v], hidden[v]) for v in cameras)))
    return needles


def _seen_of(needle: Body, camera: Camera, hidden: BoolArray) -> int:
    """How many of the pixels of a coarse image show the needle beside the screws."""
    low, high = needle.mesh.vertices_mm.min(axis=0), needle.mesh.vertices_mm.max(axis=0)
    line = low + np.linspace(0.0, 1.0, 400)[:, None] * (high - low)  # a thin wire: its box's diagonal will do
    coarse = resized(camera, hidden.shape[::-1])
    pixels = np.unique(np.round(coarse.project(transform(needle.world_from_body, line))).astype(int), axis=0)
    inside = pixels[((pixels >= 0) & (pixels < hidden.shape[::-1])).all(axis=1)]
    return int(np.count_nonzero(~hidden[inside[:, 1], inside[:, 0]]))


def random_detector(
    rng: np.random.Generator, image_size: tuple[int, int], detector_mm: float, round_field: float
) -> Detector:
    """A C-arm as one meets them: flat panel or image intensifier, film-like or logarithmic, more or less noise.

    Between `screwpose.simulation.detector_presets`. Its image has no distortion: that is a dial of the scene.

    Parameters
    ----------
    detector_mm : its width.
    round_field : how often it is an image intensifier, whose field is round.
    """
    pixel_mm = detector_mm / image_size[0]
    is_round = rng.random() < round_field
    dose_ngy, old_dose_ngy = rng.uniform(100.0, 500.0), rng.uniform(100.0, 300.0)
    flat_glare, old_glare = rng.uniform(0.01, 0.03), rng.uniform(0.06, 0.13)
    return Detector(
        image_size=image_size,
        pixel_mm=pixel_mm,
        peak_kv=rng.uniform(75.0, 110.0),
        blur_px=0.15 / pixel_mm if is_round else 0.0,
        focal_spot_mm=rng.uniform(0.3, 0.6),
        screen_h_mm2=rng.uniform(0.4, 0.6),
        glare_fraction=old_glare if is_round else flat_glare,
        glare_mm=rng.uniform(15.0, 25.0),
        grid_scatter=rng.uniform(0.15, 0.28),
        scatter_sigma_px=rng.uniform(15.0, 25.0) / pixel_mm,
        counts_per_px=_QUANTA_PER_NGY * (old_dose_ngy if is_round else dose_ngy) * pixel_mm**2,
        electronic_noise=rng.uniform(8.0, 14.0) * pixel_mm,
        display="log" if rng.random() < 0.5 else "power",
        reference_grey=rng.uniform(0.45, 0.58),
        gamma=rng.uniform(0.55, 0.8),
        log_decades=rng.uniform(1.7, 2.2),
        field_radius_px=(0.5 - RIM) * min(image_size) if is_round else None,
    )
