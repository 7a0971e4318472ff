"""What stands in the beam of a scene: patient, metal, clutter, needles; and the detector behind it."""

from collections.abc import Sequence

import numpy as np

from screwpose.simulation.arrangement_screws import PlacedScrew
from screwpose.simulation.detector import Detector
from screwpose.simulation.materials import COBALT_CHROME, STEEL, TITANIUM, Material
from screwpose.simulation.patient import Patient
from screwpose.simulation.scenes_options import SceneOptions
from screwpose.simulation.streams import stream
from screwpose.simulation.volume import CtVolume
from screwpose.simulation.xray import Body, Layer

_KEEP_OUT_MM = 9.0  # from a screw's axis: the widest heads are 13 mm across


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
    return [*tissues, *clutter_bodies(screws, clutter_count(options, seed), seed), *implants], volume


def metal_of(seed: int) -> Material:
    """What screws and towers are made of, all of one metal. Steel and cobalt-chrome let next to nothing through."""
    return [TITANIUM, TITANIUM, COBALT_CHROME, STEEL][int(stream(seed, "metal").integers(4))]


def clutter_count(options: SceneOptions, seed: int) -> int:
    """How many pieces of other metal there are."""
    return int(stream(seed, "clutter count").integers(options.clutter[0], options.clutter[1] + 1))


def clutter_bodies(screws: Sequence[PlacedScrew], count: int, seed: int) -> list[Body]:
    """Instruments that the screws do not touch."""
    if count == 0:
        return []
    from screwpose.simulation.instruments import random_clutter

    keep_out = [(screw.landmarks_in_world_mm[0], screw.axis_in_world, _KEEP_OUT_MM) for screw in screws]
    return random_clutter(stream(seed, "clutter"), keep_out, count)


def needle_bodies(screws: Sequence[PlacedScrew]) -> list[Body]:
    """For each screw a needle along its tower."""
    from screwpose.simulation.needles import needle_along

    return [needle_along(screw.implant, screw.world_from_cad @ screw.upright_from_tower) for screw in screws]


def random_detector(rng: np.random.Generator, image_size: tuple[int, int], round_field: float = 0.35) -> Detector:
    """A display chain as one meets them: flat panel or round field, film-like or logarithmic, more or less noise.

    Parameters
    ----------
    round_field : how often the field is round.
    """
    scale = image_size[0] / 1024
    is_round = rng.random() < round_field
    return Detector(
        image_size=image_size,
        peak_kv=rng.uniform(80.0, 110.0),
        blur_px=rng.uniform(0.6, 1.1) * scale,
        scatter_fraction=rng.uniform(0.15, 0.4),
        scatter_sigma_px=rng.uniform(45.0, 80.0) * scale,
        counts_per_px=rng.uniform(400.0, 2000.0) / scale**2,
        display="log" if rng.random() < 0.5 else "power",
        reference_grey=rng.uniform(0.45, 0.58),
        gamma=rng.uniform(0.55, 0.8),
        log_decades=rng.uniform(1.7, 2.2),
        field_radius_px=0.5 * min(image_size) - 6.0 * scale if is_round else None,
    )
