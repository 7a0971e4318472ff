"""Compiled loops of the thickness measure: from poses to explained energy and normal equations in one call.

The same maths as `thickness.explain` and `thickness.derivatives`, which are the reference; what differs is that values
are kept for the pixels near metal alone, row by row, and that nothing is handed back but a few numbers. Bodies that
stand still while others are tried are drawn once, and only pixels near those that move are compared. One thread,
without the interpreter's lock: callers run views and scenes in several threads. Sums have one order whatever their
number, so that the same input gives the same bits on a machine.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from screwpose.projection.length_kernels import draw
from screwpose.similarity.local_kernels import localise
from screwpose.similarity.motion_kernels import (
    add_gradient,
    add_information,
    add_scores,
    pulled_by,
    steepness_of,
)
from screwpose.similarity.near_kernels import (
    add_row,
    along_row,
    long_product,
    mark_near,
    near_runs,
    scattered,
    spread_to_rows,
)
from screwpose.similarity.response_kernels import fit_response

View = namedtuple(
    "View", ["intrinsics", "camera_from_world", "along_u", "along_v", "counts", "smooth", "slope", "bounds", "is_local"]
)
"""One X-ray: see `thickness.GradientTarget`. smooth, slope (reach + 1,): the taps of the smoothing and of its
derivative from the middle outwards. bounds (4,): first row, its end, first column, its end."""

Bodies = namedtuple("Bodies", ["vertices_mm", "vertex_start", "faces", "face_start", "centers_mm"])
"""The meshes of all bodies, one after the other, and the points (B, 3) in their CAD frames about which they turn."""

Constants = namedtuple(
    "Constants",
    [
        "saturation_mm", "longest_mm", "least_mm", "rim_share", "cauchy", "reweighted", "samples", "least_cosine",
        "gain_px", "gain_hold", "most_gain", "spread_px", "spread_hold",
    ],
)  # fmt: skip
"""See `thickness`, where they are set."""

Assessed = namedtuple(
    "Assessed",
    [
        "energy", "spread", "response", "shares", "information", "gradient", "scores", "near", "mask", "residuals",
        "nearest_mm",
    ],
)  # fmt: skip
"""energy, spread, response (n,): see `thickness.Explanation`. shares (B,): the energy near each body. information
(6 B, 6 B) and gradient (6 B,): the normal equations, in units of 1 over the squared spread of one pixel. scores
(block rows, block columns, 6 B): what each block of the image adds to the gradient. All of them empty or 0 where they
are not wanted. mask (N,) and residuals (2, N): of the pixels in the runs of `near`. nearest_mm is
the smallest depth of a vertex: not positive, nothing was done."""


@njit(cache=True, nogil=True, error_model="numpy")
def assess(
    view, bodies, world_from_cad, constants, held_response, fixed_mm, with_gradient, with_information, with_shares,
    block_px,
):  # fmt: skip
    """Draw bodies at poses, fit the response, and see what is left: `Assessed`.

    Parameters
    ----------
    view, bodies, constants : `View`, `Bodies`, `Constants`.
    world_from_cad : (B, 4, 4).
    held_response : (n,), a response that is known but for a factor: it takes a third of the time; empty otherwise.
    fixed_mm : (rows, columns) of the X-ray, the path lengths through bodies that stand still; (0, 0) where none do.
    with_gradient, with_information : the right side and the matrix of the normal equations; the former is quick.
    block_px : of the scores, which come with the matrix; 0: none.
    """
    count = world_from_cad.shape[0]
    terms = len(constants.saturation_mm)
    with_motion = with_gradient or with_information
    drawn = draw(
        view.intrinsics, view.camera_from_world, world_from_cad, bodies.centers_mm, bodies.vertices_mm,
        bodies.vertex_start, bodies.faces, bodies.face_start, view.bounds, with_motion, constants.least_cosine,
    )  # fmt: skip
    unknowns = 6 * count if with_information else 0
    information, gradient = np.zeros((unknowns, unknowns)), np.zeros(6 * count if with_gradient else 0)
    shares = np.zeros(count if with_shares else 0)
    scores = np.zeros((0, 0, unknowns))
    reach = len(view.smooth) - 1
    near = near_runs(drawn, reach, view.bounds)
    size = near.offset[-1]
    if size == 0 or not drawn.nearest_mm > 0.0:
        mask, residuals = np.zeros(size, np.float32), np.zeros((2, size), np.float32)
        return Assessed(
            0.0, 1.0, np.zeros(terms), shares, information, gradient, scores, near, mask, residuals, drawn.nearest_mm
        )
    total_mm, window = _together(drawn, near, view, reach, fixed_mm)
    rows, columns = total_mm.shape
    top, left = window
    flags = np.zeros((rows, columns), np.uint8)
    for body in range(count):
        mark_near(drawn, body, reach, constants.least_mm, view.bounds, window, flags)
    image, mask = np.empty((2, size), np.float32), np.empty(size, np.float32)
    found = np.empty(columns, np.uint8)
    for row in range(len(near.run_start) - 1):
        y = near.first_row + row
        for run in range(near.run_start[row], near.run_start[row + 1]):
            first, last = near.first_column[run], near.last_column[run]
            spread_to_rows(flags, y - top, first - left, last - left, reach, found[: last - first])
            for k in range(last - first):
                place = near.offset[run] + k
                image[0, place], image[1, place] = view.along_u[y, first + k], view.along_v[y, first + k]
                mask[place] = np.float32(1.0 if found[k] and view.counts[y, first + k] else 0.0)
    basis = _basis(total_mm, near, window, view, constants, held_response)
    weights, model, residuals = np.empty_like(image), np.empty_like(image), np.empty_like(image)
    response, spread = fit_response(basis, image, mask, weights, model, residuals, constants)
    if len(held_response):
        response = held_response * response[0]
    gain = np.empty(0, np.float32)
    if view.is_local:
        gain = localise(near, window, total_mm.shape, image, model, mask, spread, constants, weights, residuals)
    left_over, seen = 0.0, 0.0
    for along in range(2):
        left_over += long_product(residuals[along] * mask, residuals[along])
        seen += long_product(image[along] * mask, image[along])
    energy = 1.0 - left_over / max(seen, 1e-300) if seen > 0.0 else 0.0
    if with_shares:
        _share(drawn, near, window, flags, reach, view, constants, image, mask, residuals, shares)
    if with_motion:
        steepness = steepness_of(drawn, response, constants, total_mm, window)
        placed = np.zeros((2, rows, columns), np.float32)
        if with_gradient:
            for along in range(2):
                pulls = weights[along] * residuals[along]
                if view.is_local:
                    pulls *= gain
                scattered(near, window, pulls, placed[along])
            add_gradient(drawn, steepness, pulled_by(placed, view), window, gradient)
        if with_information:
            with_scores = block_px > 0 and with_gradient
            pulled = placed.copy() if with_scores else placed
            for along in range(2):
                if view.is_local:
                    weights[along] *= gain * gain
                scattered(near, window, weights[along], placed[along])
            motions = add_information(
                drawn, (view.smooth, view.slope), view.bounds, steepness, window, placed, information
            )
            if with_scores:
                down, across = view.counts.shape
                scores = np.zeros(((down - 1) // block_px + 1, (across - 1) // block_px + 1, unknowns))
                add_scores(motions, window, pulled, block_px, scores)
    return Assessed(
        energy, spread, response, shares, information, gradient, scores, near, mask, residuals, drawn.nearest_mm
    )


@njit(cache=True, nogil=True, error_model="numpy")
def energies_of(view, bodies, candidates, constants, held_response, fixed_mm):
    """The explained energies (K,) with one body at each of K poses (K, 4, 4), and the smallest depth of any vertex."""
    energies, nearest_mm = np.empty(len(candidates)), np.inf
    for k in range(len(candidates)):
        one = assess(view, bodies, candidates[k : k + 1], constants, held_response, fixed_mm, False, False, False, 0)
        energies[k], nearest_mm = one.energy, min(nearest_mm, one.nearest_mm)
    return energies, nearest_mm


@njit(cache=True, nogil=True, error_model="numpy")
def lengths_of(view, bodies, world_from_cad, constants):
    """The path lengths of all bodies together, (rows, columns) of the X-ray, and the smallest depth of a vertex."""
    drawn = draw(
        view.intrinsics, view.camera_from_world, world_from_cad, bodies.centers_mm, bodies.vertices_mm,
        bodies.vertex_start, bodies.faces, bodies.face_start, view.bounds, False, constants.least_cosine,
    )  # fmt: skip
    total_mm = np.zeros(view.counts.shape, np.float32)
    _add_lengths(drawn, (0, 0), total_mm)
    return total_mm, drawn.nearest_mm


@njit(cache=True, nogil=True, error_model="numpy")
def _add_lengths(drawn, window, total_mm):
    top, left = window
    for body in range(len(drawn.first_row)):
        for place in range(drawn.row_start[body], drawn.row_start[body + 1]):
            row = drawn.first_row[body] + place - drawn.row_start[body] - top
            for k in range(drawn.offset[place], drawn.offset[place + 1]):
                total_mm[row, drawn.first_column[place] + k - drawn.offset[place] - left] += np.float32(
                    drawn.lengths_mm[k]
                )


@njit(cache=True, nogil=True, error_model="numpy")
def _together(drawn, near, view, reach, fixed_mm):
    """All path lengths, of bodies that move and that stand still, in a window, and where it begins: row, column."""
    bounds = view.bounds
    top, bottom = near.first_row, near.first_row + len(near.run_start) - 1
    left, right = near.first_column[0], near.last_column[0]
    for run in range(len(near.first_column)):
        left, right = min(left, near.first_column[run]), max(right, near.last_column[run])
    if fixed_mm.shape[0]:  # metal that stands still goes on beyond what is near metal that moves
        top, bottom = max(top - reach, bounds[0]), min(bottom + reach, bounds[1])
        left, right = max(left - reach, bounds[2]), min(right + reach, bounds[3])
        total_mm = fixed_mm[top:bottom, left:right].copy()
    else:
        total_mm = np.zeros((bottom - top, right - left), np.float32)
    _add_lengths(drawn, (top, left), total_mm)
    return total_mm, (top, left)


@njit(cache=True, nogil=True, error_model="numpy")
def _metal_spans(total_mm, near, window, reach, longest_mm):
    """In each row of the window the columns that near pixels above and below ask for, and those of metal that reaches
    them: firsts and ends of both. Clips the lengths in place."""
    top, left = window
    rows, columns = total_mm.shape
    first_asked, last_asked = np.full(rows, columns), np.zeros(rows, np.int64)
    for near_row in range(len(near.run_start) - 1):
        row = near.first_row + near_row - top
        for run in range(near.run_start[near_row], near.run_start[near_row + 1]):
            for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
                first_asked[other] = min(first_asked[other], near.first_column[run] - left)
                last_asked[other] = max(last_asked[other], near.last_column[run] - left)
    begins, ends = np.full(rows, columns), np.zeros(rows, np.int64)
    for row in range(rows):
        for column in range(max(first_asked[row] - reach, 0), min(last_asked[row] + reach, columns)):
            length = total_mm[row, column]
            if length != np.float32(0.0):
                total_mm[row, column] = min(max(length, np.float32(0.0)), np.float32(longest_mm))
                begins[row] = min(begins[row], column)
                ends[row] = column + 1
    return first_asked, last_asked, begins, ends


@njit(cache=True, nogil=True, error_model="numpy")
def _basis(total_mm, near, window, view, constants, held_response):
    """Derivatives of the saturating exponentials of the path length, (n, 2, N), or of the response that is held,
    (1, 2, N); clips the lengths in place."""
    top, left = window
    rows, columns = total_mm.shape
    reach = len(view.smooth) - 1
    is_held = len(held_response) > 0
    terms = 1 if is_held else len(constants.saturation_mm)
    # Metal's own span in each row: the filters along it are 0 elsewhere.
    first_asked, last_asked, begins, ends = _metal_spans(total_mm, near, window, reach, constants.longest_mm)
    basis = np.zeros((terms, 2, near.offset[-1]), np.float32)
    smoothed, sloped = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    padded = np.zeros(columns + 4 * reach, np.float32)
    for term in range(terms):
        per_mm = np.float32(-1.0 / constants.saturation_mm[term])
        for row in range(rows):
            if ends[row] <= begins[row]:
                continue
            first, last = max(begins[row] - reach, first_asked[row]), min(ends[row] + reach, last_asked[row])
            if last <= first:
                continue
            padded[: last - first + 2 * reach] = np.float32(0.0)
            for column in range(max(begins[row], first - reach), min(ends[row], last + reach)):
                length = total_mm[row, column]
                if length != np.float32(0.0) and is_held:
                    total = np.float32(0.0)
                    for i in range(len(held_response)):
                        if held_response[i] > 0.0:
                            per_mm = np.float32(-1.0 / constants.saturation_mm[i])
                            total += np.float32(held_response[i]) * (np.float32(1.0) - np.exp(length * per_mm))
                    padded[column - first + reach] = total
                elif length != np.float32(0.0):
                    padded[column - first + reach] = np.float32(1.0) - np.exp(length * per_mm)
            along_row(padded, last - first, view.smooth, view.slope, smoothed[row, first:last], sloped[row, first:last])
        for near_row in range(len(near.run_start) - 1):
            row = near.first_row + near_row - top
            for run in range(near.run_start[near_row], near.run_start[near_row + 1]):
                first, last = near.first_column[run] - left, near.last_column[run] - left
                for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
                    if ends[other] <= begins[other]:
                        continue
                    begin, end = max(first, begins[other] - reach), min(last, ends[other] + reach)
                    if begin >= end:
                        continue
                    away = other - row
                    steep = view.slope[abs(away)] if away > 0 else -view.slope[abs(away)]
                    goal = slice(near.offset[run] + begin - first, near.offset[run] + end - first)
                    add_row(
                        smoothed[other, begin:end], sloped[other, begin:end], view.smooth[abs(away)], steep,
                        basis[term, 0, goal], basis[term, 1, goal],
                    )  # fmt: skip
    return basis


@njit(cache=True, nogil=True, error_model="numpy")
def _share(drawn, near, window, flags, reach, view, constants, image, mask, residuals, shares):
    """The explained share of the energy near each body: all bodies explain, one is looked at."""
    found = np.empty(flags.shape[1], np.uint8)
    top, left = window
    for body in range(len(shares)):
        flags[:] = 0
        mark_near(drawn, body, reach, constants.least_mm, view.bounds, window, flags)
        seen, left_over = 0.0, 0.0
        for row in range(len(near.run_start) - 1):
            for run in range(near.run_start[row], near.run_start[row + 1]):
                first, last = near.first_column[run] - left, near.last_column[run] - left
                spread_to_rows(flags, near.first_row + row - top, first, last, reach, found[: last - first])
                for k in range(last - first):
                    place = near.offset[run] + k
                    if found[k] and mask[place] > 0:
                        seen += image[0, place] ** 2 + image[1, place] ** 2
                        left_over += residuals[0, place] ** 2 + residuals[1, place] ** 2
        shares[body] = 1.0 - left_over / max(seen, 1e-300) if seen > 0.0 else 0.0
