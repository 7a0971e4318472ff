"""Cases with known truth: two pedicle screws with towers, seen from the front and from the side.

Everything follows from the seed. The patient lies in the world frame of `screwpose.simulation.anatomy` (LPS, mm), and
the towers stand backwards out of the skin.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from screwpose.files.case import Annotation
from screwpose.files.result import PosedImplant
from screwpose.geometry.camera import Camera
from screwpose.implants.design import ScrewDesign
from screwpose.implants.model import Implant
from screwpose.simulation.anatomy import patient
from screwpose.simulation.arrangement import Arrangement, arrange, landmarks_px
from screwpose.simulation.detector import Detector
from screwpose.simulation.materials import COBALT_CHROME, STEEL, TITANIUM
from screwpose.simulation.xray import Body, Layer, SimulatedXray, render_views


@dataclass(frozen=True, eq=False)
class SimulatedView:
    """One X-ray with its exact camera."""

    camera: Camera
    xray: SimulatedXray


@dataclass(frozen=True, eq=False)
class SimulatedCase:
    """A case, and the truth about it.

    Parameters
    ----------
    views : by name, AP and LAT.
    implants : by model name, as the solver is given them: exact CAD.
    annotations : by view name, what a person would have marked. Their labels say nothing across views.
    screws : the truth: labels by view, model and pose.
    overlap : by view name, the share of the smaller silhouette that lies within the other screw's.
    """

    id: str
    seed: int
    views: Mapping[str, SimulatedView]
    implants: Mapping[str, Implant]
    annotations: Mapping[str, tuple[Annotation, ...]]
    screws: tuple[PosedImplant, ...]
    overlap: Mapping[str, float]


def two_screw_scene(
    seed: int,
    *,
    landmark_noise_px: float = 1.5,
    image_size: tuple[int, int] = (1024, 1024),
    with_anatomy: bool = True,
    designs: tuple[ScrewDesign, ScrewDesign] | None = None,
) -> SimulatedCase:
    """Two pedicle screws with towers, left and right, of one level or of neighbours, overlapping in LAT.

    Parameters
    ----------
    seed : of everything. Seeds span overlaps in LAT from touching to complete.
    landmark_noise_px : standard deviation of the marks, in u and in v, Gaussian.
    image_size : (width, height) in px. The detector stays 307 mm wide: fewer pixels are larger ones.
    with_anatomy : False leaves the patient away: metal in air.
    designs : of the two screws; by default both are of one random design. Annotations name the model, which tells two
        different designs apart.

    Raises
    ------
    ScrewposeError
        No arrangement was found that shows both screws: the designs are too large for the field of view.
    """
    # One stream for each thing, so that an option for one of them does not change the others.
    layout_rng, patient_rng, metal_rng, detector_rng, mark_rng, *view_rngs = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(7)
    )
    scene = arrange(layout_rng, image_size, designs)
    tissues = patient(scene.anatomy, patient_rng) if with_anatomy else []
    # Towers and screws are of one metal here. Steel and cobalt-chrome let next to nothing through.
    metal = [TITANIUM, TITANIUM, COBALT_CHROME, STEEL][int(metal_rng.integers(4))]
    bodies = list(tissues)
    for implant, pose in zip(scene.implants, scene.poses, strict=True):
        bodies.append(Body(implant.mesh, metal, world_from_body=pose, layer=Layer.IMPLANT))
    chain = random_detector(detector_rng, image_size)
    xrays = render_views(scene.cameras, bodies, chain, dict(zip(scene.cameras, view_rngs, strict=True)))
    views = {name: SimulatedView(camera, xrays[name]) for name, camera in scene.cameras.items()}
    annotations, screws = _marked(scene, landmark_noise_px, mark_rng)
    return SimulatedCase(
        id=f"two-screws-{seed}",
        seed=seed,
        views=views,
        implants={implant.name: implant for implant in scene.implants},
        annotations=annotations,
        screws=screws,
        overlap=scene.overlap,
    )


def random_detector(rng: np.random.Generator, image_size: tuple[int, int]) -> Detector:
    """A display chain as one meets them: flat panel or round field, film-like or logarithmic, more or less noise."""
    scale = image_size[0] / 1024
    is_round = rng.random() < 0.35
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


def _marked(
    scene: Arrangement, noise_px: float, rng: np.random.Generator
) -> tuple[dict[str, tuple[Annotation, ...]], tuple[PosedImplant, ...]]:
    """What a person marks in each view, with labels that do not say which is which in the other."""
    names = {"AP": ("1", "2"), "LAT": ("a", "b")}
    annotations: dict[str, tuple[Annotation, ...]] = {}
    labels: list[dict[str, str]] = [{}, {}]
    for view, camera in scene.cameras.items():
        marks = []
        for name, index in zip(names[view], rng.permutation(2).tolist(), strict=True):
            implant = scene.implants[index]
            tip, center = landmarks_px(camera, implant, scene.poses[index]) + rng.normal(0.0, noise_px, (2, 2))
            marks.append(Annotation(name, tip, center, implant.name))
            labels[index][view] = name
        annotations[view] = tuple(marks)
    screws = tuple(PosedImplant(labels[index], scene.implants[index].name, scene.poses[index]) for index in range(2))
    return annotations, screws
