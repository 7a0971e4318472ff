"""The field of view: where the detector saw the beam at all."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, ImageArray
from screwpose.images.radiograph import Radiograph

# All lengths are for an image whose longer side is 1024 px, and grow with it.
_BLUR_PX = 3.0
_CLOSING_PX = 9.0
_MARGIN_PX = 8.0
_SHAPE_TOLERANCE_PX = 4.0

_LEAST_OUTSIDE = 0.003  # of the image: a field that cuts the corners alone leaves more
_LEAST_SOLIDITY = 0.92  # of the region in its convex hull
_LEAST_ON_CIRCLE = 0.6  # of the edge: collimator blades may make the rest

_LEAST_STEP = 12 / 255
_BLOCKED_SHARPNESS = 0.5  # real images: 0.56 and more, skin of a limb: 0.45 and less
_DRAWN_SHARPNESS = 0.6

# An image intensifier's glass scatters a halo of up to 25/255 round its field (real biplane images), dense tissue
# starts near 40/255. The smaller ones are for images whose open beam or tissue is as black as their border.
_LEVELS = (35 / 255, 12 / 255, 3 / 255, 0.5 / 255)


def field_of_view(image: Radiograph | ImageArray) -> BoolArray:
    """Find the part of the image that the beam reached: a disc, a collimated rectangle, or all of a flat panel.

    The outside is a flat area at one end of the grey range that comes in from the image's border and leaves a convex
    disc, rectangle or polygon with a sharp edge. A blocked beam is bright here, as metal is. A border that was
    blackened in a metal-bright file is dark here, and so is open beam: there the shape must be a disc, or its edge as
    sharp as a drawn one.

    Parameters
    ----------
    image : a Radiograph, or (rows, columns), metal bright, in [0, 1].

    Returns
    -------
    (rows, columns); true inside, less a margin of 8 px per 1024 where the edge of the field blurs. All true where no
    such outside is found.
    """
    pixels = image.pixels if isinstance(image, Radiograph) else np.asarray(image, dtype=np.float32)
    scale = max(pixels.shape) / 1024.0
    for attenuation, sharpness in ((pixels, _BLOCKED_SHARPNESS), (1.0 - pixels, _DRAWN_SHARPNESS)):
        for level in _LEVELS:
            inside = _inside(attenuation, level, scale)
            if inside is None:
                continue
            shape, is_round = _regular_shape(inside, scale)
            least = _BLOCKED_SHARPNESS if is_round else sharpness
            if shape is not None and _has_sharp_edge(attenuation, shape, scale, least):
                return _eroded(shape, _MARGIN_PX * scale)
    return np.ones(pixels.shape, dtype=np.bool_)


def _inside(attenuation: NDArray[Any], level: float, scale: float) -> BoolArray | None:
    """What is left when the flat black area that comes in from the border is taken away, or None."""
    import cv2

    blurred = cv2.GaussianBlur(attenuation, (0, 0), _BLUR_PX * scale, borderType=cv2.BORDER_REPLICATE)
    black = (blurred > 1.0 - level).astype(np.uint8)
    count, labels = cv2.connectedComponents(black, connectivity=4)
    rim = np.zeros(black.shape, dtype=np.bool_)
    rim[[0, -1], :] = rim[:, [0, -1]] = True
    at_rim = np.zeros(count, dtype=np.bool_)
    at_rim[np.unique(labels[rim])] = True
    at_rim[0] = False
    outside = at_rim[labels]
    if not _LEAST_OUTSIDE < outside.mean() < 0.97:
        return None
    size = 2 * round(_CLOSING_PX * scale) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    inside = cv2.morphologyEx((~outside).astype(np.uint8), cv2.MORPH_OPEN, kernel)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(inside, connectivity=4)
    if len(stats) < 2:
        return None
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _regular_shape(inside: BoolArray, scale: float) -> tuple[BoolArray | None, bool]:
    """Complete the region to the disc, rectangle or convex polygon that it is (None: it is none), and whether a disc.

    Tissue as black as the outside bites into the region. The convex hull bridges a bite by a chord that the region
    itself does not touch; where the rest of the edge lies on a circle or a rectangle, what the chord cut off is given
    back. A collimator blade also leaves a chord, but the region touches it: it stays.
    """
    import cv2

    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.convexHull(np.concatenate(contours))
    convex = _filled(hull, inside.shape)
    if inside.sum() < _LEAST_SOLIDITY * convex.sum() or convex.mean() > 1.0 - _LEAST_OUTSIDE:
        return None, False
    box = cv2.boxPoints(cv2.minAreaRect(hull))
    rectangle = _filled(np.round(box), inside.shape)
    if convex.sum() > 0.98 * rectangle.sum():
        return rectangle, False
    corners = hull[:, 0, :].astype(np.float64)
    tolerance = _SHAPE_TOLERANCE_PX * scale
    off_outline_px = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) + cv2.distanceTransform(
        1 - inside.astype(np.uint8), cv2.DIST_L2, 5
    )
    points, edge_index = _points_along(corners)
    u, v = np.round(points).astype(int).T
    inner = np.all((points > 3.0 * scale) & (points < np.array(inside.shape[::-1]) - 1 - 3.0 * scale), axis=1)
    touching = off_outline_px[v, u] < tolerance
    circle = _circle_through(points[inner & touching], tolerance)
    if circle is not None:
        for index in np.unique(edge_index[inner & ~touching]):
            if np.mean(touching[edge_index == index]) < 0.5:
                chord = corners[index], corners[(index + 1) % len(corners)]
                convex |= _segment_beyond(chord, circle, corners.mean(axis=0), inside.shape)
        contours, _ = cv2.findContours(convex.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        convex = _filled(cv2.convexHull(np.concatenate(contours)), inside.shape)
    return convex, circle is not None


def _filled(polygon: NDArray[Any], shape: tuple[int, ...]) -> BoolArray:
    import cv2

    canvas = np.zeros(shape[:2], dtype=np.uint8)
    cv2.fillConvexPoly(canvas, polygon.astype(np.int32), 1)
    return canvas.astype(np.bool_)


def _points_along(polygon: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points about every pixel along a closed polygon, (N, 2) as (u, v), and the edge that each is on, (N,)."""
    steps = np.roll(polygon, -1, axis=0) - polygon
    counts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1)).astype(np.int64), 1)
    edge = np.repeat(np.arange(len(polygon)), counts)
    along = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[edge]
    return polygon[edge] + steps[edge] * along[:, None], edge


def _circle_through(points: NDArray[np.float64], tolerance_px: float) -> tuple[float, float, float] | None:
    """(u, v, radius) of the circle that most of the points lie on, by random sampling with a fixed seed, or None."""
    if len(points) < 16:
        return None
    rng = np.random.default_rng(0)
    best = np.zeros(len(points), dtype=np.bool_)
    for trial in _circles_through(points[rng.integers(0, len(points), (200, 3))]):
        on = np.abs(_distance(points, trial) - trial[2]) < tolerance_px
        best = on if on.sum() > best.sum() else best
    circle = _fit_circle(points[best]) if best.sum() >= 3 else None
    if circle is None or best.mean() < _LEAST_ON_CIRCLE:
        return None
    # A flat arc fits a straight edge: the circle must be one that the image could hold.
    span = np.ptp(points, axis=0).max()
    if circle[2] > span or _distance(points, circle).min() < 0.9 * circle[2]:
        return None
    return circle


def _circles_through(triples: NDArray[np.float64]) -> list[tuple[float, float, float]]:
    """The circles through three points each, (N, 3, 2); `_fit_circle` of each, but for those on a line."""
    middles = triples.mean(axis=1)
    centred = triples - middles[:, None]
    systems = np.concatenate([2.0 * centred, np.ones((*centred.shape[:2], 1))], axis=2)
    is_round = np.linalg.cond(systems) <= 1e8
    a, b, c = np.linalg.solve(systems[is_round], (centred[is_round] ** 2).sum(axis=2)[..., None])[..., 0].T
    u, v = middles[is_round].T + (a, b)
    return list(zip(u.tolist(), v.tolist(), np.sqrt(np.maximum(c + a * a + b * b, 0.0)).tolist(), strict=True))


def _fit_circle(points: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Kasa's algebraic least squares: u^2 + v^2 = 2 a u + 2 b v + c."""
    centred = points - points.mean(axis=0)
    system = np.column_stack([2.0 * centred, np.ones(len(points))])
    if np.linalg.cond(system) > 1e8:
        return None
    a, b, c = np.linalg.lstsq(system, (centred**2).sum(axis=1), rcond=None)[0]
    u, v = points.mean(axis=0) + (a, b)
    return float(u), float(v), float(np.sqrt(max(c + a * a + b * b, 0.0)))


def _distance(points: NDArray[np.float64], circle: tuple[float, float, float]) -> NDArray[np.float64]:
    return np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1])


def _segment_beyond(
    chord: tuple[NDArray[np.float64], NDArray[np.float64]],
    circle: tuple[float, float, float],
    centre: NDArray[np.float64],
    shape: tuple[int, ...],
) -> BoolArray:
    """The part of the disc on the other side of a chord than `centre`."""
    (u0, v0), (u1, v1) = chord
    v, u = np.ogrid[: shape[0], : shape[1]]
    side = (u - u0) * (v1 - v0) - (v - v0) * (u1 - u0)
    side_of_centre = (centre[0] - u0) * (v1 - v0) - (centre[1] - v0) * (u1 - u0)
    disc = (u - circle[0]) ** 2 + (v - circle[1]) ** 2 <= circle[2] ** 2
    return np.asarray(disc & (side * side_of_centre < 0))


def _has_sharp_edge(attenuation: NDArray[Any], region: BoolArray, scale: float, least: float) -> bool:
    """Whether most of the region's edge is a step, as a shutter or a blackened border makes.

    The skin of a limb in a saturated beam also leaves flat areas on both sides of a convex shape, and towers stand in
    them. But there the attenuation begins like a root: over 36 px of the profile no 4 px hold most of the change.
    """
    import cv2

    distance = cv2.GaussianBlur(region.astype(np.float32), (0, 0), 6.0 * scale, borderType=cv2.BORDER_REPLICATE)
    normal_u, normal_v = cv2.Scharr(distance, cv2.CV_32F, 1, 0), cv2.Scharr(distance, cv2.CV_32F, 0, 1)
    edge = cv2.erode(region.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) != region
    v, u = np.nonzero(edge)
    if len(u) == 0:
        return False
    points = np.linspace(0, len(u) - 1, min(len(u), 400)).astype(int)
    v, u = v[points], u[points]
    length = np.hypot(normal_u[v, u], normal_v[v, u]) + 1e-9
    along_px = np.arange(-40.0, 41.0) * max(scale, 0.5)
    profile = cv2.remap(
        attenuation,
        (u[:, None] + along_px * (normal_u[v, u] / length)[:, None]).astype(np.float32),
        (v[:, None] + along_px * (normal_v[v, u] / length)[:, None]).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # The outline may lie some px off the edge: look round the steepest place of each profile.
    steps = np.abs(profile[:, 4:] - profile[:, :-4])
    centre = np.clip(steps[:, 16:-16].argmax(axis=1) + 16, 16, 60)
    around = np.take_along_axis(profile, centre[:, None] + 2 + np.arange(-18, 19), axis=1)
    change = np.ptp(around, axis=1)
    if np.median(change) <= _LEAST_STEP:
        return False
    share = steps.max(axis=1) / np.maximum(change, _LEAST_STEP)
    return bool(np.median(share[change > _LEAST_STEP]) > least)


def _eroded(region: BoolArray, margin_px: float) -> BoolArray:
    """Take the margin off the region's own edge; where the image cuts it there is nothing blurred."""
    import cv2

    size = 2 * round(margin_px) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    eroded = cv2.erode(region.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return eroded.astype(np.bool_)
