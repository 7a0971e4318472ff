"""Where screws and C-arm stand: drawn until it is the situation that was asked for."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.errors import ScrewposeError
from screwpose.geometry.camera import Camera
from screwpose.implants.model import Implant
from screwpose.simulation.arrangement_gaps import Capsules, least_gap_mm
from screwpose.simulation.arrangement_screws import (
    PlacedScrew,
    capsules_of,
    drawn_screw,
    drawn_sites,
    placed_capsules,
    towards_head_mm,
)
from screwpose.simulation.carm import put_up_views, resized
from screwpose.simulation.patient import Level
from screwpose.simulation.scenes_options import SceneOptions

_ATTEMPTS = 1500
_HOPELESS = 300  # attempts of which none gets as far as a picture
_TRIES_A_SCREW = 25
_MARGIN_PX = 20.0  # of 1024: tips and centres keep this from the border, and from a round field's rim
_RIM_PX = 6.0  # of 1024, as `screwpose.simulation.scenes_bodies.RIM`
_LEAST_GAP_MM = 1.0  # between two screws
_WIDTH_PX = 1024
_WIDE_FROM_LEVELS = 5
_USUAL_MM, _WIDE_MM = 307.2, 430.0

Refusal = tuple[str, str]
"""Why an arrangement will not do: which bound it breaks, and what that means for a user."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where everything is, before anything is rendered.

    Parameters
    ----------
    cameras, isocenters : by view name: as put up, without any imperfection, and what each is aimed at.
    in_field : by view name, for each screw whether tip and centre are in the field.
    """

    screws: tuple[PlacedScrew, ...]
    cameras: Mapping[str, Camera]
    isocenters: Mapping[str, FloatArray]
    in_field: Mapping[str, BoolArray]


def arranged(
    rng: np.random.Generator,
    options: SceneOptions,
    levels: Sequence[Level],
    implants: Sequence[Implant],
    is_round: Callable[[bool], bool],
    suits: Callable[[Arrangement], str | None],
) -> Arrangement:
    """Draw until the screws are apart from each other and all else is as asked.

    All is decided at one resolution, so that the number of pixels does not change the arrangement.

    Parameters
    ----------
    levels : of the patient.
    is_round : whether the field is a circle, given whether it takes a large flat panel.
    suits : what is wrong with an arrangement, in a few words; None where nothing is. It is asked last.

    Raises
    ------
    ScrewposeError
        No such arrangement was found; says what the attempts failed at.
    """
    capsules = {implant.name: capsules_of(implant) for implant in implants}
    failures: Counter[str] = Counter()
    for attempt in range(_ATTEMPTS):
        sites = drawn_sites(rng, options, len(implants), len(levels))
        screws = _screws_apart(rng, options, levels, implants, sites, capsules)
        if screws is None:
            failures["the screws touch"] += 1
        else:
            arrangement = _seen(rng, options, screws, is_round)
            refusal = suits(arrangement)
            if refusal is None:
                return arrangement
            failures[refusal] += 1
        hopeless = failures.most_common(1)[0]
        if attempt >= _HOPELESS and hopeless[0] in _GEOMETRIC and hopeless[1] == attempt + 1:
            break
    told = ", ".join(f"{reason} ({count})" for reason, count in failures.most_common())
    raise ScrewposeError(
        f"no arrangement of {len(implants)} screws was found in {sum(failures.values())} attempts: {told}. "
        "Ask for fewer or shorter screws, for wider ranges, or for a larger image."
    )


OUT_OF_FIELD = "tips or centres are out of the field"
_GEOMETRIC = ("the screws touch", OUT_OF_FIELD)


def _screws_apart(
    rng: np.random.Generator,
    options: SceneOptions,
    levels: Sequence[Level],
    implants: Sequence[Implant],
    sites: Sequence[tuple[int, int]],
    capsules: Mapping[str, tuple[Capsules, ...]],
) -> tuple[PlacedScrew, ...] | None:
    """One after the other, each where it has room; None where there is none."""
    numbers = sorted({level for level, _ in sites})
    common = rng.normal(0.0, options.cranial_tilt_deg)
    # The towers of two neighbours lean towards each other, as they do where one works between them.
    apart = rng.uniform(2.0, 12.0) if len(numbers) == 2 else 0.0
    placed: list[PlacedScrew] = []
    taken: list[Capsules] = []
    for implant, site in zip(implants, sites, strict=True):
        lean = common + apart * (1.0 if site[0] == numbers[0] else -1.0)
        for _ in range(_TRIES_A_SCREW):
            screw = drawn_screw(rng, options, implant, levels[site[0]], site, lean)
            room = placed_capsules(screw, capsules[implant.name])
            if all(least_gap_mm(room, other) >= _LEAST_GAP_MM for other in taken):
                placed.append(screw)
                taken.append(room)
                break
        else:
            return None
    return tuple(placed)


def is_long(screws: Sequence[PlacedScrew]) -> bool:
    """Whether they span so many levels that it takes a large flat panel."""
    return len({screw.level for screw in screws}) >= _WIDE_FROM_LEVELS


def detector_width_mm(options: SceneOptions, is_wide: bool) -> float:
    """The one asked for, or the usual."""
    return (_WIDE_MM if is_wide else _USUAL_MM) if options.detector_mm is None else options.detector_mm


def _seen(
    rng: np.random.Generator, options: SceneOptions, screws: tuple[PlacedScrew, ...], is_round: Callable[[bool], bool]
) -> Arrangement:
    is_wide = is_long(screws)
    has_circle = is_round(is_wide)
    height = round(_WIDTH_PX * options.image_size[1] / options.image_size[0])
    middles = [s.landmarks_in_world_mm[1] + towards_head_mm(s.implant) * s.axis_in_world for s in screws]
    cameras, isocenters = put_up_views(
        rng,
        (_WIDTH_PX, height),
        detector_width_mm(options, is_wide),
        rng.uniform(*options.angle_deg),
        np.mean(middles, axis=0),
        options.pose_sd_deg,
        options.isocenter_sd_mm,
        rng.uniform(*options.shift_mm),
        # What is long is brought nearer to the detector.
        (680.0, 720.0) if is_wide else (630.0, 670.0),
    )
    in_field = {
        name: np.array([_is_in_field(camera, screw, has_circle) for screw in screws])
        for name, camera in cameras.items()
    }
    return Arrangement(
        screws, {name: resized(camera, options.image_size) for name, camera in cameras.items()}, isocenters, in_field
    )


def _is_in_field(camera: Camera, screw: PlacedScrew, is_round: bool) -> bool:
    """Whether tip and centre are well within the field."""
    assert camera.image_size is not None
    half = 0.5 * np.array(camera.image_size)
    offsets = np.abs(camera.project(screw.landmarks_in_world_mm) - (half - 0.5))
    if is_round:
        return bool(np.hypot(*offsets.T).max() <= half.min() - _RIM_PX - _MARGIN_PX)
    return bool((offsets <= half - _MARGIN_PX).all())
