"""What makes a case hard: measured from the case and its truth alone, so that anybody's cases have it."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from pydantic import Field

from screwpose._types import BoolArray, FloatArray
from screwpose.files.case import Annotation, Case, View
from screwpose.files.schema import TruthFile, TruthScrew
from screwpose.files.values import Count, FileModel, Fraction, Name, NotNegative, Number
from screwpose.geometry import Camera, rigid
from screwpose.geometry.epipolar import epipolar_distances_px
from screwpose.implants.model import Implant, Mesh

# Overlaps are shares: on a raster of some 500 px they are known to 1 %.
_RASTER_PX = 512


class Strata(FileModel):
    """What makes a case hard. Defined in docs/measures.md."""

    screws: Count = Field(description="screws of the truth")
    overlap: dict[Name, Fraction] = Field(
        description="for each view the largest share of one screw's silhouette that others cover"
    )
    epipolar_ambiguity_px: NotNegative | None = Field(
        None, description="the smallest change of the mean epipolar distance by swapping two screws' labels, px"
    )
    epipolar_margin_px: Number | None = Field(
        None, description="the same, signed, the least of it: negative where epipolar distances prefer a wrong pairing"
    )
    landmark_noise_px: NotNegative | None = Field(
        None, description="root mean square distance, per coordinate, of the marks from the true landmarks, px"
    )
    view_angle_deg: NotNegative | None = Field(None, description="angle between the first two views' rays, degrees")
    marks_missing: Count = Field(description="how many marks the case lacks: screws times views, less the marks")


def strata_of(case: Case, truth: TruthFile) -> Strata:
    """Measure a case. Screws whose model the case does not have are counted and otherwise left out."""
    known = [screw for screw in truth.screws if screw.model in case.implants]
    margins = _swap_margins_px(case, truth.screws)
    return Strata(
        screws=len(truth.screws),
        overlap={name: _overlap(view, known, case.implants) for name, view in case.views.items()},
        epipolar_ambiguity_px=min(map(abs, margins), default=None),
        epipolar_margin_px=min(margins, default=None),
        landmark_noise_px=_landmark_noise_px(case, known),
        view_angle_deg=_view_angle_deg(case, known),
        marks_missing=sum(len(case.views) - len(screw.labels) for screw in truth.screws),
    )


def posed_meshes(screw: TruthScrew, implant: Implant) -> list[tuple[Mesh, FloatArray]]:
    """What stands where: the parts at their own poses where the truth has all of them, else the whole implant."""
    parts = screw.parts or {}
    if implant.parts and all(part.name in parts for part in implant.parts):
        return [(part.mesh, np.array(parts[part.name])) for part in implant.parts]
    return [(implant.mesh, np.array(screw.world_from_cad))]


def _overlap(view: View, screws: Sequence[TruthScrew], implants: Mapping[str, Implant]) -> float:
    masks = [_coarse_silhouette(view, screw, implants[screw.model]) for screw in screws]
    covered = sum((mask.astype(np.int64) for mask in masks), np.int64(0))
    shares = [float((mask & (covered > 1)).sum() / mask.sum()) for mask in masks if mask.any()]
    return max(shares, default=0.0)


def _coarse_silhouette(view: View, screw: TruthScrew, implant: Implant) -> BoolArray:
    from screwpose.projection.opencv import silhouette

    rows, columns = view.radiograph.pixels.shape
    coarse = max(1.0, max(rows, columns) / _RASTER_PX)
    mask = np.zeros((int(np.ceil(rows / coarse)), int(np.ceil(columns / coarse))), dtype=np.bool_)
    for mesh, world_from_cad in posed_meshes(screw, implant):
        vertices = rigid.transform(world_from_cad, mesh.vertices_mm)
        if view.camera.depth_mm(vertices).min() > 0.0:
            coarse_px = (view.camera.project(vertices) + 0.5) / coarse - 0.5
            mask |= silhouette(coarse_px, mesh.faces, mask.shape)
    return mask


def _marks(case: Case, screw: TruthScrew) -> dict[str, Annotation]:
    """The screw's marks by view."""
    return {
        view: mark
        for view, label in screw.labels.items()
        for mark in case.annotations.get(view, ())
        if mark.label == label
    }


def _swap_margins_px(case: Case, screws: Sequence[TruthScrew]) -> list[float]:
    """For every two screws and two views that show both: epipolar distance when swapped, less when not, px."""
    margins = []
    marks = [_marks(case, screw) for screw in screws]
    for (name_a, view_a), (name_b, view_b) in combinations(case.views.items(), 2):
        both = [(one[name_a], one[name_b]) for one in marks if name_a in one and name_b in one]
        for first, second in combinations(both, 2):
            margins.append(_swap_margin_px(view_a.camera, view_b.camera, first, second))
    return margins


def _swap_margin_px(
    camera_a: Camera,
    camera_b: Camera,
    first: tuple[Annotation, Annotation],
    second: tuple[Annotation, Annotation],
) -> float:
    swapped_less_true = []
    for point in ("tip_px", "center_px"):
        in_a = np.array([getattr(one[0], point) for one in (first, second)])
        in_b = np.array([getattr(one[1], point) for one in (first, second)])
        d = epipolar_distances_px(camera_a, camera_b, in_a, in_b)
        swapped_less_true.append(0.5 * (d[0, 1] + d[1, 0]) - 0.5 * (d[0, 0] + d[1, 1]))
    return float(np.mean(swapped_less_true))


def _landmark_noise_px(case: Case, screws: Sequence[TruthScrew]) -> float | None:
    offsets = []
    for screw in screws:
        implant = case.implants[screw.model]
        points = rigid.transform(np.array(screw.world_from_cad), np.array([implant.tip_mm, implant.center_mm]))
        for name, mark in _marks(case, screw).items():
            camera = case.views[name].camera
            if camera.depth_mm(points).min() > 0.0:
                offsets.append(np.array([mark.tip_px, mark.center_px]) - camera.project(points))
    return float(np.sqrt(np.mean(np.square(offsets)))) if offsets else None


def _view_angle_deg(case: Case, screws: Sequence[TruthScrew]) -> float | None:
    if not screws:
        return None
    centers = [
        rigid.transform(np.array(screw.world_from_cad), case.implants[screw.model].center_mm) for screw in screws
    ]
    first, second = (view.camera.center_in_world_mm for view in list(case.views.values())[:2])
    middle = np.mean(centers, axis=0)
    return float(np.degrees(rigid.angle_between_rad(middle - first, middle - second)))
