"""Compiled loops of the blurred thickness model: from poses and a blur to the normal equations of a view in one call.

The same maths as `blurred.explain_blurred` and `blurred.derivatives_of_bodies`, which are the reference. Images lie
dense in a window, and are touched in the runs of columns that metal reaches; what comes of derivatives is kept for
those runs alone. One thread, without the interpreter's lock.

Three things differ from the reference, all in the Jacobian alone and by a few percent: what the principal point and
the focal length change is taken from differences of neighbouring pixels of the model, to the fourth order; an edge's
steepness is held while the blur changes; and the blur's derivatives are exact where the reference takes differences.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from screwpose.projection.length_kernels import draw
from screwpose.similarity.blur_kernels import gathered, through_blur
from screwpose.similarity.motion_kernels import add_gradient, add_information, pulled_by
from screwpose.similarity.near_kernels import add_row, along_row, mark_near, near_runs, product, spread_to_rows
from screwpose.similarity.response_kernels import fit_response

View = namedtuple(
    "View",
    [
        "intrinsics",
        "camera_from_world",
        "along_u",
        "along_v",
        "counts",
        "smooth",
        "slope",
        "reach",
        "px_per_px",
        "fine",
    ],
)
"""One X-ray: see `thickness.GradientTarget`. smooth, slope (taps + 1,): of the model's smoothing and of its derivative,
from the middle outwards. reach: how far from metal derivatives are compared. px_per_px: how much of a pixel here one of
the whole X-ray is. fine: each pixel is drawn as so many by so many rays."""

Spread = namedtuple("Spread", ["smooth", "change", "weights", "by_sigma", "by_tail", "per_mm", "edge_px", "by_edge",
                               "by_per_mm", "steep_smooth", "steep_slope"])  # fmt: skip
"""A blur: smooth and change (3, taps + 1), of each Gaussian of the mixture and how they change with its variance; their
weights (3,), and by how much their variances change with the standardised sigma and tail (3,); the attenuation, the
shift of edges, by how much they change with theirs; taps that find how steep an edge is."""

Motion = namedtuple("Motion", ["smooth", "slope"])
"""Taps by which the change of a path length shows: the model's, and the blur's before."""

Found = namedtuple("Found", ["energy", "spread", "information", "gradient", "nearest_mm"])
"""information (6 B + 7 + n, ...) and gradient (6 B + 7 + n,), in units of 1 over the squared spread of one pixel: of
the bodies, of the image, and of the response's n weights that are not 0."""

Limits = namedtuple(
    "Limits",
    ["longest_mm", "least_mm", "least_lit", "rim_share", "cauchy", "reweighted", "samples", "least_cosine"],
)
"""See `thickness` and `blurred`, where they are set."""

OF_IMAGE = 7
_MARGIN = 2  # of what differences of neighbours need


@njit(cache=True, nogil=True, error_model="numpy")
def assess_blurred(view, bodies, world_from_cad, spread, motion, table, per_table_mm, limits):
    """Draw bodies at poses, blur them, fit the response, and linearise: `Found`.

    Parameters
    ----------
    bodies : as in `kernels`.
    limits : `Limits`.
    world_from_cad : (B, 4, 4).
    table : (entries, terms), the ramps at path lengths of 0, 1, 2 .. over `per_table_mm`.
    """
    count, terms = world_from_cad.shape[0], table.shape[1]
    first, size = 6 * count, 6 * count + OF_IMAGE
    taps = len(view.smooth) - 1
    widest = max(view.reach + _MARGIN + taps, spread.smooth.shape[1] - 1, len(motion.smooth) - 1)
    rows_of_image, columns_of_image = view.counts.shape
    # Metal beyond the border blurs into the image.
    bounds = np.array([-widest, rows_of_image + widest, -widest, columns_of_image + widest])
    K = view.intrinsics.copy()
    K[:2] *= view.fine
    K[:2, 2] += 0.5 * (view.fine - 1)
    finer = draw(
        K, view.camera_from_world, world_from_cad, bodies.centers_mm, bodies.vertices_mm, bodies.vertex_start,
        bodies.faces, bodies.face_start, view.fine * bounds, True, limits.least_cosine,
    )  # fmt: skip
    drawn = gathered(finer, view.fine)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    wide = near_runs(drawn, widest, bounds)
    if wide.offset[-1] == 0 or not drawn.nearest_mm > 0.0:
        return Found(0.0, 1.0, information, gradient, drawn.nearest_mm)
    rows = len(wide.run_start) - 1
    left, right = wide.first_column[0], wide.last_column[0]
    for run in range(len(wide.first_column)):
        left, right = min(left, wide.first_column[run]), max(right, wide.last_column[run])
    pad = widest
    left -= pad  # so that filters find their zeros
    shape = (rows, right + pad - left)
    window = (wide.first_row, left)
    flags = np.zeros(shape, np.uint8)
    for body in range(count):
        mark_near(drawn, body, view.reach, limits.least_mm, bounds, window, flags)
    fine_mm = np.zeros((view.fine * rows, view.fine * shape[1]), np.float32)
    for body in range(count):
        for place in range(finer.row_start[body], finer.row_start[body + 1]):
            row = finer.first_row[body] + place - finer.row_start[body] - view.fine * wide.first_row
            shift = finer.first_column[place] - finer.offset[place] - view.fine * left
            for k in range(finer.offset[place], finer.offset[place + 1]):
                fine_mm[row, k + shift] += np.float32(finer.lengths_mm[k])
    scratch = np.zeros((3, *shape), np.float32)
    through, by_blur = through_blur(shape, fine_mm, wide, left, spread, view.px_per_px, scratch, limits)
    scratch[:] = np.float32(0.0)
    near = near_runs(drawn, view.reach + _MARGIN, bounds)
    packed = near.offset[-1]
    image, mask = np.zeros((2, packed), np.float32), np.zeros(packed, np.float32)
    found = np.empty(shape[1], np.uint8)
    counted = 0
    for row in range(len(near.run_start) - 1):
        y = near.first_row + row
        if y < 0 or y >= rows_of_image:
            continue
        for run in range(near.run_start[row], near.run_start[row + 1]):
            begin, end = max(near.first_column[run], 0), min(near.last_column[run], columns_of_image)
            if begin >= end:
                continue
            spread_to_rows(flags, y - wide.first_row, begin - left, end - left, view.reach, found[: end - begin])
            for x in range(begin, end):
                if found[x - begin] and view.counts[y, x]:
                    place = near.offset[run] + x - near.first_column[run]
                    image[0, place], image[1, place] = view.along_u[y, x], view.along_v[y, x]
                    mask[place] = np.float32(1.0)
                    counted += 1
    if counted == 0:
        return Found(0.0, 1.0, information, gradient, drawn.nearest_mm)
    basis = np.empty((terms, 2, packed), np.float32)
    shown = np.zeros(shape, np.float32)
    for term in range(terms):
        _look_up(table[:, term].copy(), per_table_mm, through, wide, left, shown)
        _differentiate(shown, wide, near, left, view.smooth, view.slope, scratch, basis[term])
    norms = np.empty(terms)
    for term in range(terms):
        norms[term] = np.sqrt(_energy(basis[term], mask) + 1e-300)
        basis[term] *= np.float32(1.0 / norms[term])
    weights, model, residuals = np.empty_like(image), np.empty_like(image), np.empty_like(image)
    response, sigma = fit_response(basis, image, mask, weights, model, residuals, limits)
    energy = 1.0 - _energy(residuals, mask) / max(_energy(image, mask), 1e-300)
    _look_up(_steepness(table, per_table_mm, response / norms), per_table_mm, through, wide, left, shown)
    active = np.flatnonzero(response > 0.0)
    columns = np.empty((OF_IMAGE + len(active), 2, packed), np.float32)
    for k in range(len(active)):
        columns[OF_IMAGE + k] = basis[active[k]]
    size = first + len(columns)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    _by_intrinsics(model, near, view, columns)
    changed = np.zeros(shape, np.float32)
    for k in range(4):
        for row in range(rows):
            for run in range(wide.run_start[row], wide.run_start[row + 1]):
                own = slice(wide.first_column[run] - left, wide.last_column[run] - left)
                changed[row, own] = shown[row, own] * by_blur[k, row, own]
        _differentiate(changed, wide, near, left, view.smooth, view.slope, scratch, columns[3 + k])
    placed = np.zeros((4, *shape), np.float32)
    for row in range(len(near.run_start) - 1):
        for run in range(near.run_start[row], near.run_start[row + 1]):
            values = slice(near.offset[run], near.offset[run + 1])
            y = near.first_row + row - wide.first_row
            own = slice(near.first_column[run] - left, near.last_column[run] - left)
            for along in range(2):
                placed[along, y, own] = weights[along, values]
                placed[2 + along, y, own] = residuals[along, values]
    per_drawn = np.zeros(len(drawn.lengths_mm), np.float32)
    for body in range(count):
        for place in range(drawn.row_start[body], drawn.row_start[body + 1]):
            row = drawn.first_row[body] + place - drawn.row_start[body] - wide.first_row
            for k in range(drawn.offset[place], drawn.offset[place + 1]):
                per_drawn[k] = shown[row, drawn.first_column[place] + k - drawn.offset[place] - left]
    moved = add_information(
        drawn, (motion.smooth, motion.slope), bounds, per_drawn, window, placed[:2], information[:first, :first]
    )
    add_gradient(drawn, per_drawn, pulled_by(placed[:2] * placed[2:], motion), window, gradient[:first])
    _add_columns(columns, weights, residuals, near, moved, count, information, gradient)
    return Found(energy, sigma, information, gradient, drawn.nearest_mm)


@njit(cache=True, nogil=True, error_model="numpy")
def _steepness(table, per_mm, response):
    """How the response changes with the length, per mm, at the table's entries."""
    steepness = np.zeros(table.shape[0], np.float32)
    for term in range(len(response)):
        if response[term] > 0.0:
            for entry in range(table.shape[0]):
                above, below = min(entry + 1, table.shape[0] - 1), max(entry - 1, 0)
                rise = (np.float64(table[above, term]) - np.float64(table[below, term])) / (above - below)
                steepness[entry] += np.float32(response[term] * per_mm * rise)
    return steepness


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(table, per_mm, lengths, wide, left, shown):
    """A table's values at the lengths, between its entries by straight lines."""
    last = len(table) - 1
    scale = np.float32(per_mm)
    for row in range(len(wide.run_start) - 1):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            for x in range(wide.first_column[run] - left, wide.last_column[run] - left):
                place = lengths[row, x] * scale
                below = min(np.int64(place), last - 1)
                share = place - np.float32(below)
                shown[row, x] = table[below] + share * (table[below + 1] - table[below])


@njit(cache=True, nogil=True, error_model="numpy")
def _differentiate(image, wide, near, left, smooth, slope, scratch, out):
    """Derivatives (2, N) along u and v in the runs of `near` of an image that is 0 outside those of `wide`."""
    taps = len(smooth) - 1
    for row in range(len(wide.run_start) - 1):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            first, last = wide.first_column[run] - left, wide.last_column[run] - left
            along_row(
                image[row, first - taps : last + taps], last - first, smooth, slope, scratch[0, row, first:last],
                scratch[1, row, first:last],
            )  # fmt: skip
    out[:] = np.float32(0.0)
    rows = len(wide.run_start) - 1
    for row in range(len(near.run_start) - 1):
        y = near.first_row + row - wide.first_row
        for run in range(near.run_start[row], near.run_start[row + 1]):
            first, last = near.first_column[run] - left, near.last_column[run] - left
            own = slice(near.offset[run], near.offset[run + 1])
            for other in range(max(y - taps, 0), min(y + taps + 1, rows)):
                away = other - y
                steep = slope[abs(away)] if away > 0 else -slope[abs(away)]
                add_row(
                    scratch[0, other, first:last], scratch[1, other, first:last], smooth[abs(away)], steep,
                    out[0, own], out[1, own],
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _energy(values, mask):
    total = 0.0
    for along in range(2):
        for begin in range(0, len(mask), 512):
            end = min(begin + 512, len(mask))
            total += np.float64(product(values[along, begin:end] * mask[begin:end], values[along, begin:end]))
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _by_intrinsics(model, near, view, columns):
    """Of the logarithm of the focal length, and of the principal point, px of the whole X-ray.

    With x and y the pixels from the principal point: a focal length that is longer by a share e makes
    ``-e (x m_u + y m_v)`` of an image m; of its derivatives, but for what the smoothing's own width does, ``-e (x d_u +
    y d_v + d)``.
    """
    rows = len(near.run_start) - 1
    columns[:3] = np.float32(0.0)
    steps = np.array([-2, -1, 1, 2])
    factors = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    for row in range(rows):
        y = near.first_row + row
        down = np.float32(y - view.intrinsics[1, 2])
        for run in range(near.run_start[row], near.run_start[row + 1]):
            first, last, offset = near.first_column[run], near.last_column[run], near.offset[run]
            for along in range(2):
                u, v = columns[1, along], columns[2, along]
                for k in range(4):
                    step, factor = steps[k], np.float32(factors[k])
                    for x in range(max(first, first - step), min(last, last - step)):
                        u[offset + x - first] += factor * model[along, offset + x - first + step]
                    if 0 <= row + step < rows:
                        for its in range(near.run_start[row + step], near.run_start[row + step + 1]):
                            shift = near.offset[its] - near.first_column[its]
                            for x in range(max(first, near.first_column[its]), min(last, near.last_column[its])):
                                v[offset + x - first] += factor * model[along, shift + x]
                for x in range(first, last):
                    place = offset + x - first
                    across = np.float32(x - view.intrinsics[0, 2])
                    columns[0, along, place] = -(across * u[place] + down * v[place] + model[along, place])
                    u[place] *= np.float32(-view.px_per_px)
                    v[place] *= np.float32(-view.px_per_px)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_columns(columns, weights, residuals, near, moved, count, information, gradient):
    """The normal equations of what moves the image, with each other and with the bodies' motions."""
    first, size = 6 * count, len(columns)
    packed = len(weights[0])
    weighted = np.empty((size, 2, packed), np.float32)
    for k in range(size):
        for along in range(2):
            for i in range(packed):
                weighted[k, along, i] = columns[k, along, i] * weights[along, i]
    for along in range(2):
        for begin in range(0, packed, 512):
            end = min(begin + 512, packed)
            for k in range(size):
                part = weighted[k, along, begin:end]
                gradient[first + k] += np.float64(product(part, residuals[along, begin:end]))
                for j in range(k, size):
                    information[first + k, first + j] += np.float64(product(part, columns[j, along, begin:end]))
    values, near_rows, rows_of, near_left, near_right, near_offset = moved
    for body in range(count):
        for row in range(rows_of[body + 1] - rows_of[body]):
            place = rows_of[body] + row
            if near_right[place] <= near_left[place]:
                continue
            y = near_rows[body] + row - near.first_row
            if y < 0 or y >= len(near.run_start) - 1:
                continue
            for run in range(near.run_start[y], near.run_start[y + 1]):
                begin, end = (
                    max(near_left[place], near.first_column[run]),
                    min(near_right[place], near.last_column[run]),
                )
                if begin >= end:
                    continue
                shift = near_offset[place] - near_left[place]
                its = near.offset[run] - near.first_column[run]
                for along in range(2):
                    for i in range(6):
                        source = values[i, along, begin + shift : end + shift]
                        for k in range(size):
                            information[6 * body + i, first + k] += np.float64(
                                product(source, weighted[k, along, begin + its : end + its])
                            )
    for i in range(first + size):
        for j in range(max(i, first), first + size):
            information[j, i] = information[i, j]
