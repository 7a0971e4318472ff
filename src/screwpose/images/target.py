"""Metal implants segmented from the image itself: the target of the Dice score.

A grey level cannot tell metal: a tower over air is paler than a spine without any metal. What tells it is its outline:
all round it the attenuation rises steeply. So the image is flattened by top-hats of several radii, each is cut at many
levels, and of all the connected pieces that appear those are kept whose outlines are steep along most of their length.
Of nested pieces the one (or the set) with the most steep outline wins, which gives each implant its own threshold: a
pale tower and a dark shank stay one piece, a spur of bone that joins them at low levels does not.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, ImageArray
from screwpose.images.pieces import Cuts, Piece, best_pieces, cut_at, pieces_of
from screwpose.images.preparation import carried_outwards, log_image, smoothed

# Lengths are for an image whose longer side is 1024 px, and grow with it.
_WORKING_PX = 512  # longer side on which pieces are sought; outlines are refined on the full image
_RADII_PX = (12.0, 30.0, 70.0, 110.0)  # half widths that the top-hats keep: shank, tower, two towers, knee
_LEVELS = 24
_LEAST_LEVEL = 0.02  # of a top-hat; 1 is what leaves 3/255 of the beam
_LEAST_OVER_NOISE = 3.0  # levels and outlines below this many medians are noise
_LARGEST_HOLE_PX2 = 24_000.0  # a tower's inside between its walls, seen from the side
_LEAST_AREA_PX2 = 60.0
_BAND_PX = 4.0
_LOCAL_PX = 15.0

# An outline counts where its steepness exceeds this share of what the steepest outlines of the image have.
_STEEP_SHARE = 0.35
_STEEP_CAP = 2.0  # beyond twice that, steeper is not better: else the dark shank alone would win over shank and tower
# With a hint, what is steep and what is dark is measured by what is about: within this radius, and at least a floor of
# a share of the greatest and of the median (noise, texture).
_AROUND_PX = 40.0
_FLOOR_SHARE = 0.03
_FLOOR_NOISE = 1.5
_LEAST_GAIN_KEPT = 0.6  # by a piece that replaces those in it
_LEAST_MEAN_KEPT = 0.85
_LEAST_GAIN_PX = 50.0  # steep outline that a piece must have, net of outline that is not


def metal_target(pixels: ImageArray, region: BoolArray, near: BoolArray | None = None) -> BoolArray:
    """Segment the metal implants.

    Parameters
    ----------
    pixels : (rows, columns), metal bright, in [0, 1].
    region : (rows, columns), M_bg: what lies outside is never metal.
    near : (rows, columns), where the implants in question are, with a margin of some tens of px, or None for
        everywhere: then it is made from a first pass. With it each place has its own scale of what is dark and steep,
        so that a tower that is pale over air stays one with its screw. Metal outside (table, retractor) is left out.

    Returns
    -------
    (rows, columns). All false where no outline is steep enough. Holes up to a tower's inside are filled.
    """
    if near is None:
        first = _metal(pixels, region, region, hinted=False)
        return _metal(pixels, region, region & _grown(first, _AROUND_PX * _scale(pixels.shape)), hinted=True)
    return _metal(pixels, region, region & near, hinted=True)


def _metal(pixels: ImageArray, region: BoolArray, wanted: BoolArray, hinted: bool) -> BoolArray:
    result = np.zeros(region.shape, dtype=np.bool_)
    if not wanted.any():
        return result
    scale = _scale(pixels.shape)
    window = _window(wanted, margin_px=round(_RADII_PX[-1] * scale))
    metal = _pieces_of_metal(log_image(pixels[window]), region[window], wanted[window], hinted, scale)
    absorbed = smoothed(np.asarray(pixels[window], dtype=np.float32), 0.8 * scale)
    result[window] = _refined(absorbed, metal, region[window], scale) & wanted[window]
    return result


def _grown(mask: BoolArray, radius_px: float) -> BoolArray:
    import cv2

    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= radius_px) & mask.any()


def _scale(shape: tuple[int, ...]) -> float:
    return max(shape) / 1024.0


def _window(wanted: BoolArray, margin_px: int) -> tuple[slice, slice]:
    """Rows and columns that hold all of `wanted` and its surroundings."""
    ends = []
    for axis in (1, 0):
        hit = np.flatnonzero(wanted.any(axis=axis))
        ends.append(slice(max(0, int(hit[0]) - margin_px), int(hit[-1]) + 1 + margin_px))
    return ends[0], ends[1]


def _pieces_of_metal(
    attenuation: ImageArray, region: BoolArray, wanted: BoolArray, hinted: bool, scale: float
) -> BoolArray:
    """The metal at working size, brought back to the size of `attenuation`."""
    import cv2

    factor = min(1.0, _WORKING_PX / (1024.0 * scale))
    size = (max(8, round(region.shape[1] * factor)), max(8, round(region.shape[0] * factor)))
    unit = factor * scale  # working pixels per pixel of a 1024 px image
    small: ImageArray = np.asarray(cv2.resize(attenuation, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    inside = cv2.resize(region.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) != 0
    sought = cv2.resize(wanted.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) != 0
    small = smoothed(carried_outwards(small, inside), 0.8)
    steepness = _steepness(small) * inside
    hats = [_evened(hat, sought, unit) if hinted else hat for hat in _top_hats(small, unit)]
    families = [_cuts(hat, inside, unit) for hat in hats]
    steepest = _steepest_outlines(families, steepness, sought, unit)
    metal = np.zeros(small.shape, dtype=np.bool_)
    if steepest > _LEAST_OVER_NOISE * float(np.median(steepness[sought])):
        floor = _FLOOR_SHARE * steepest + _FLOOR_NOISE * float(np.median(steepness[sought]))
        neutral = _STEEP_SHARE * (_peak_around(steepness, sought, floor, unit) if hinted else steepest)
        gain = np.minimum(steepness / neutral, _STEEP_CAP) - 1.0
        pieces = [piece for family in families for piece in _best_pieces(family, gain, unit)]
        _add_pieces(metal, pieces, sought)
    back = cv2.resize(metal.astype(np.float32), region.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(back > 0.5)


def _steepness(image: NDArray[Any]) -> NDArray[Any]:
    """Length of the gradient, its greatest within a pixel's neighbours: an outline need not hit it exactly."""
    import cv2

    along = [cv2.Scharr(image, cv2.CV_32F, 1, 0), cv2.Scharr(image, cv2.CV_32F, 0, 1)]
    return np.asarray(cv2.dilate(np.hypot(along[0], along[1]) / 32.0, np.ones((3, 3), np.uint8)))


def _top_hats(image: NDArray[Any], unit: float) -> Iterator[NDArray[Any]]:
    """The image less its opening by discs; wide openings are smooth and computed on a reduced grid."""
    import cv2

    for radius in _RADII_PX:
        step = max(1, int(radius * unit / 12.0))
        reduced = (max(1, image.shape[1] // step), max(1, image.shape[0] // step))
        size = 2 * max(1, round(radius * unit / step)) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        opened = cv2.morphologyEx(cv2.resize(image, reduced, interpolation=cv2.INTER_AREA), cv2.MORPH_OPEN, kernel)
        opened = cv2.resize(opened, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
        yield np.maximum(image - opened, 0.0)


def _cuts(hat: NDArray[Any], inside: BoolArray, unit: float) -> Cuts:
    """Cut a top-hat from its highest level to its lowest; small holes are filled."""
    top = float(np.percentile(hat[inside], 99.95))
    lowest = max(_LEAST_LEVEL, 0.05 * top, _LEAST_OVER_NOISE * float(np.median(hat[inside])))
    levels = np.geomspace(0.97 * top, lowest, _LEVELS) if lowest < top else np.zeros(0)
    return cut_at(hat, inside, levels, _LARGEST_HOLE_PX2 * unit**2)


def _steepest_outlines(families: list[Cuts], steepness: NDArray[Any], sought: BoolArray, unit: float) -> float:
    """The mean steepness that the steepest twentieth of all outlines has, by length, of pieces that lie in `sought`."""
    means, lengths = [np.zeros(0)], [np.zeros(0)]
    for cuts in families:
        pieces = pieces_of(cuts, [steepness, sought])
        total, within = pieces.sums.T
        counts = (pieces.length >= 60.0 * unit) & (within > 0.5 * pieces.length)
        means.append(total[counts] / pieces.length[counts])
        lengths.append(pieces.length[counts].astype(np.float64))
    mean, weight = np.concatenate(means), np.concatenate(lengths)
    if len(mean) == 0:
        return 0.0
    order = np.argsort(mean, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    return float(mean[order][np.searchsorted(share, 0.95)])


def _evened(hat: NDArray[Any], sought: BoolArray, unit: float) -> NDArray[Any]:
    """A top-hat relative to the highest round about: a tower is paler over air than over the patient, and still one."""
    top = float(np.percentile(hat[sought], 99.95))
    noise = float(np.median(hat[sought]))
    return np.asarray(hat / _peak_around(hat, sought, _FLOOR_SHARE * top + _FLOOR_NOISE * noise, unit))


def _peak_around(values: NDArray[Any], sought: BoolArray, floor: float, unit: float) -> NDArray[Any]:
    """The highest value round each pixel, within `sought`, smoothly; at least the floor.

    Where implants were said to be near, the steepest and darkest about is theirs; without that word it may be bone's.
    """
    import cv2

    cell = max(1, round(8 * unit))
    size = (max(1, sought.shape[1] // cell), max(1, sought.shape[0] // cell))
    peak = cv2.dilate((values * sought).astype(np.float32), np.ones((cell, cell), np.uint8))
    peak = cv2.resize(peak, size, interpolation=cv2.INTER_NEAREST)
    reach = 2 * max(1, round(_AROUND_PX * unit / cell)) + 1
    peak = cv2.dilate(peak, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    peak = cv2.blur(peak, (reach, reach), borderType=cv2.BORDER_REPLICATE)
    peak = cv2.resize(peak, sought.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.maximum(peak, max(floor, 1e-6))


def _best_pieces(cuts: Cuts, gain: NDArray[Any], unit: float) -> list[Piece]:
    """Choose among nested pieces.

    The outline of two dark walls is longer than that of the pale tower that they belong to, so the gain may fall by
    some share; its mean along the outline may hardly fall, or spurs of bone would come in.
    """
    least_area = _LEAST_AREA_PX2 * unit**2
    return best_pieces(cuts, gain, _LEAST_GAIN_KEPT, _LEAST_MEAN_KEPT, _LEAST_GAIN_PX * unit, least_area)


def _add_pieces(metal: BoolArray, pieces: list[Piece], sought: BoolArray) -> None:
    """Add pieces, those of the greatest gain first; the radii find most of them more than once."""
    flat_metal, flat_sought = metal.reshape(-1), sought.ravel()
    for piece in sorted(pieces, key=lambda piece: -piece.gain):
        area = len(piece.pixels)
        if flat_sought[piece.pixels].sum() >= 0.5 * area and flat_metal[piece.pixels].sum() < 0.3 * area:
            flat_metal[piece.pixels] = True


def _refined(absorbed: ImageArray, metal: BoolArray, region: BoolArray, scale: float) -> BoolArray:
    """Put the outline where the intensity is half-way between metal and surroundings, each as it is near by.

    The detector blurs intensity: half-way in its logarithm would lie inside the outline of thick metal.
    """
    import cv2

    size = 2 * max(1, round(_BAND_PX * scale)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    mask = metal.astype(np.uint8)
    wide = cv2.dilate(mask, disc)
    core = cv2.erode(mask, disc, borderValue=1)
    inner, inner_weight = _local_mean(absorbed, core != 0, scale)
    thin, thin_weight = _local_mean(absorbed, metal, scale)
    inner = np.where(inner_weight > 0.02, inner, thin)
    outer, outer_weight = _local_mean(absorbed, (wide == 0) & region, scale)
    sure = (wide != 0) & (core == 0) & (thin_weight > 0) & (outer_weight > 0) & (inner > outer)
    return np.where(sure, absorbed > 0.5 * (inner + outer), metal) & region


def _local_mean(image: ImageArray, where: BoolArray, scale: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """The mean of the pixels `where` in a square window, and the share of the window that they fill."""
    import cv2

    size = 2 * max(1, round(_LOCAL_PX * scale)) + 1
    weight = where.astype(np.float32)
    total = cv2.blur(image * weight, (size, size), borderType=cv2.BORDER_CONSTANT)
    filled = cv2.blur(weight, (size, size), borderType=cv2.BORDER_CONSTANT)
    filled = np.where(filled > 0.5 / size**2, filled, 0.0)
    return total / np.maximum(filled, 1e-9), filled
