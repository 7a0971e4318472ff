"""Compiled silhouettes of closed surfaces: only the contour is drawn, the edges between a face seen and one not seen.

Along a row of pixels, the faces that look towards the source cover a pixel as often as the contour winds around it:
each crossing of the row with a contour edge raises or lowers that number, and the mask is where it is not zero. So of a
mesh only the plane of each face is read (one sign a face), then its edges (one comparison), and only the few hundred
vertices of the contour are projected.

One thread each, no shared state, as in `kernels`.
"""

import math

import numpy as np
from numba import njit

from screwpose.projection.contour import Room
from screwpose.projection.kernels import fill_within, lowest_bit, project, set_run

# Rows with more crossings than this are sorted by a row of bits: linear, but dearer for few.
_FEW = 20


@njit(cache=True, nogil=True, error_model="numpy")
def source_of(pixels_from_cad, source_mm):
    """The point (3,) that projects nowhere: the X-ray source, in the frame of the points. NaN where there is none."""
    P = pixels_from_cad
    a, b, c = P[0, 0], P[0, 1], P[0, 2]
    d, e, f = P[1, 0], P[1, 1], P[1, 2]
    g, h, i = P[2, 0], P[2, 1], P[2, 2]
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    scale = -1.0 / (a * A + b * B + c * C)
    x, y, z = P[0, 3], P[1, 3], P[2, 3]
    source_mm[0] = scale * (A * x + (c * h - b * i) * y + (b * f - c * e) * z)
    source_mm[1] = scale * (B * x + (a * i - c * g) * y + (c * d - a * f) * z)
    source_mm[2] = scale * (C * x + (b * g - a * h) * y + (a * e - b * d) * z)


@njit(cache=True, nogil=True, error_model="numpy")
def find_contour(planes, edge_faces, source_mm, is_seen, contour):
    """List the edges between a face that looks towards the source and one that does not.

    Parameters
    ----------
    planes : (4, F), normal and offset of every face: it looks towards points with ``n . x > offset``.
    edge_faces : (E, 2), the face that runs along an edge, and the one that runs against it.
    source_mm : (3,).
    is_seen : (F,) uint8, filled.
    contour : (E + 1,), filled: the edges' numbers.

    Returns
    -------
    How many there are.
    """
    x, y, z = source_mm
    for face in range(planes.shape[1]):
        is_seen[face] = planes[0, face] * x + planes[1, face] * y + planes[2, face] * z > planes[3, face]
    count = 0
    for edge in range(edge_faces.shape[0]):
        contour[count] = edge  # no branch: which edges belong is hard to foresee
        count += is_seen[edge_faces[edge, 0]] ^ is_seen[edge_faces[edge, 1]]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def place_contour(
    pixels_from_cad, vertices_mm, edge_vertices, edge_faces, is_seen, contour, count, lines, reach, starts
):
    """Project the contour's edges, and count how many cross each row.

    Parameters
    ----------
    contour, count : of `find_contour`.
    lines : (E, 4), filled for the edges that cross a row: u and v of the upper end, u per row, u of the lower end.
    reach : (E, 3), filled: first and last row (not included) and the sign of the crossing.
    starts : (rows + 1,), zero; filled: crossings before each row.

    Returns
    -------
    How many edges cross a row, the first row crossed and the last (not included).
    """
    P = pixels_from_cad
    rows = starts.shape[0] - 1
    bottom_px = np.float64(rows)
    kept, top, bottom = 0, rows, 0
    for k in range(count):
        edge = contour[k]
        a, b = edge_vertices[edge, 0], edge_vertices[edge, 1]
        x, y, z = vertices_mm[a, 0], vertices_mm[a, 1], vertices_mm[a, 2]
        per_depth = 1.0 / (P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3])
        ua = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * per_depth
        va = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * per_depth
        x, y, z = vertices_mm[b, 0], vertices_mm[b, 1], vertices_mm[b, 2]
        per_depth = 1.0 / (P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3])
        ub = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * per_depth
        vb = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * per_depth
        sign = is_seen[edge_faces[edge, 0]]
        if vb < va:
            ua, va, ub, vb = ub, vb, ua, va
            sign ^= 1
        first = np.int64(math.ceil(min(max(va, 0.0), bottom_px)))
        last = np.int64(math.ceil(min(max(vb, 0.0), bottom_px)))
        if first >= last:
            continue
        lines[kept, 0], lines[kept, 1], lines[kept, 2] = ua, va, (ub - ua) / (vb - va)
        lines[kept, 3] = ub
        reach[kept, 0], reach[kept, 1], reach[kept, 2] = first, last, sign
        kept += 1
        starts[first] += 1
        starts[last] -= 1
        top, bottom = min(top, first), max(bottom, last)
    running, total = 0, 0
    for row in range(top, bottom):
        running += starts[row]
        starts[row] = total
        total += running
    starts[bottom] = total
    return kept, top, bottom


@njit(cache=True, nogil=True, error_model="numpy")
def cross_rows(lines, reach, kept, columns, cursor, crossings):
    """Write every crossing behind the others of its row: twice its first column inside, plus 1 where it raises.

    Parameters
    ----------
    cursor : (rows,), where each row's next crossing is written; moved on.
    """
    last_px = np.float64(columns)
    for line in range(kept):
        u, v, per_row, end = lines[line, 0], lines[line, 1], lines[line, 2], lines[line, 3]
        sign = np.int32(reach[line, 2])
        if min(u, end) > -0.5 and max(u, end) < last_px - 1.5:
            for row in range(reach[line, 0], reach[line, 1]):
                place = cursor[row]
                # The cut to an integer rounds down; past an edge by less than 1e-3 px the centre may fall either way.
                crossings[place] = (np.int32(u + (row - v) * per_row + 1.0) << 1) | sign
                cursor[row] = place + 1
        else:
            for row in range(reach[line, 0], reach[line, 1]):
                place = cursor[row]
                column = np.int32(min(max(u + (row - v) * per_row + 1.0, 0.0), last_px))
                crossings[place] = (column << 1) | sign
                cursor[row] = place + 1


@njit(cache=True, nogil=True, error_model="numpy")
def fill_rows(starts, top, bottom, crossings, winding, is_crossed, bits, extents):
    """Set the bits of the pixels around which the contour winds.

    Parameters
    ----------
    starts : (rows + 1,), where each row's crossings begin, from row `top` to `bottom`.
    crossings : of `cross_rows`; left sorted in part.
    winding, is_crossed : (64 words + 1,) and (words + 1,), zero, and left so: by how much the number of windings
        changes at a column, and whether it was touched.
    bits : (rows, words), what is set stays.
    extents : (rows, 2), widened: first and last word (not included) of each row that holds a bit.
    """
    for row in range(top, bottom):
        begin, end = starts[row], starts[row + 1]
        if begin == end:
            continue
        if end - begin <= _FEW:
            for i in range(begin + 1, end):
                moved = crossings[i]
                j = i - 1
                while j >= begin and crossings[j] > moved:
                    crossings[j + 1] = crossings[j]
                    j -= 1
                crossings[j + 1] = moved
            left, around = crossings[begin] >> 1, 0
            extents[row, 0] = min(extents[row, 0], left >> 6)
            for i in range(begin, end):
                column = crossings[i] >> 1
                if around == 0:
                    left = column
                around += 2 * (crossings[i] & 1) - 1
                if around == 0 and left < column:
                    set_run(bits, row, left, column - 1)
            extents[row, 1] = max(extents[row, 1], ((crossings[end - 1] >> 1) + 63) >> 6)
        else:
            low, high = crossings[begin] >> 7, 0
            for i in range(begin, end):
                column = crossings[i] >> 1
                winding[column] += 2 * (crossings[i] & 1) - 1
                is_crossed[column >> 6] |= np.uint64(1) << np.uint64(column & 63)
                low, high = min(low, column >> 6), max(high, column >> 6)
            left, around = 0, 0
            for word in range(low, high + 1):
                places = is_crossed[word]
                is_crossed[word] = 0
                while places != 0:
                    column = 64 * word + np.int64(lowest_bit(places))
                    places &= places - np.uint64(1)
                    if around == 0:
                        left = column
                    around += winding[column]
                    winding[column] = 0
                    if around == 0 and left < column:
                        set_run(bits, row, left, column - 1)
            extents[row, 0] = min(extents[row, 0], low)
            extents[row, 1] = max(extents[row, 1], min(high + 1, bits.shape[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def room_for(bodies, rows, words):
    """A new `Room` for drawing any of the bodies."""
    vertices, faces, edges = 0, 0, 0
    for body in range(len(bodies.boxes)):
        vertices = max(vertices, bodies.vertex_start[body + 1] - bodies.vertex_start[body])
        faces = max(faces, bodies.face_start[body + 1] - bodies.face_start[body])
        edges = max(edges, bodies.edge_start[body + 1] - bodies.edge_start[body])
    return Room(
        np.empty(vertices),
        np.empty(vertices),
        np.empty(3),
        np.empty(faces, dtype=np.uint8),
        np.empty(edges + 1, dtype=np.int32),
        np.empty((edges, 4)),
        np.empty((edges, 3), dtype=np.int32),
        np.zeros(rows + 1, dtype=np.int32),
        np.zeros(rows, dtype=np.int32),
        np.zeros(64 * words + 1, dtype=np.int32),
        np.zeros(words + 1, dtype=np.uint64),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def draw_closed(pixels_from_cad, bodies, body, columns, room, crossings, bits, extents):
    """Set the bits of every pixel whose centre a closed body covers.

    Returns
    -------
    The room for crossings, a larger one where the given was too small; the first row with a bit and the last (not
    included).
    """
    first_face, last_face = bodies.face_start[body], bodies.face_start[body + 1]
    first_edge, last_edge = bodies.edge_start[body], bodies.edge_start[body + 1]
    edge_faces = bodies.edge_faces[first_edge:last_edge]
    source_of(pixels_from_cad, room.source_mm)
    count = find_contour(bodies.planes[:, first_face:last_face], edge_faces, room.source_mm, room.is_seen, room.contour)
    kept, top, bottom = place_contour(
        pixels_from_cad,
        bodies.vertices_mm[bodies.vertex_start[body] : bodies.vertex_start[body + 1]],
        bodies.edge_vertices[first_edge:last_edge],
        edge_faces,
        room.is_seen,
        room.contour,
        count,
        room.lines,
        room.reach,
        room.starts,
    )
    if kept == 0:
        return crossings, top, bottom
    if room.starts[bottom] > len(crossings):
        crossings = np.empty(2 * room.starts[bottom], dtype=np.int32)
    room.cursor[top:bottom] = room.starts[top:bottom]
    cross_rows(room.lines, room.reach, kept, columns, room.cursor, crossings)
    fill_rows(room.starts, top, bottom, crossings, room.winding, room.is_crossed, bits, extents)
    room.starts[top : bottom + 1] = 0
    return crossings, top, bottom


@njit(cache=True, nogil=True, error_model="numpy")
def draw_scene(pixels_from_world, world_from_cad, bodies, columns, room, crossings, bits, extents):
    """Set the bits of every pixel that any body of a scene covers: closed ones by contour, others face by face.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (B, 4, 4).
    bodies : `contour.Bodies`.
    room : of `room_for`; crossings : (any,) int32.
    bits : (rows, words), what is set stays.
    extents : (rows, 2), widened: first and last word (not included) of each row that holds a bit.

    Returns
    -------
    The room for crossings; the first row with a bit and the last (not included); the smallest depth of any vertex, mm,
    or, where all are in front of the source, of their boxes. Where it is not positive, the drawing is not finished.
    """
    P = np.empty((3, 4))
    top, bottom, nearest = bits.shape[0], 0, np.inf
    for body in range(world_from_cad.shape[0]):
        for i in range(3):
            for j in range(4):
                P[i, j] = 0.0
                for k in range(4):
                    P[i, j] += pixels_from_world[i, k] * world_from_cad[body, k, j]
        vertices_mm = bodies.vertices_mm[bodies.vertex_start[body] : bodies.vertex_start[body + 1]]
        depth = P[2, 3]
        for k in range(3):
            depth += min(P[2, k] * bodies.boxes[body, 0, k], P[2, k] * bodies.boxes[body, 1, k])
        if not depth > 0.0 or not bodies.is_closed[body]:
            depth = project(P, vertices_mm, room.u, room.v)
        nearest = min(nearest, depth)
        if not nearest > 0.0:
            break
        if bodies.is_closed[body]:
            crossings, first, last = draw_closed(P, bodies, body, columns, room, crossings, bits, extents)
        else:
            faces = bodies.faces[bodies.face_start[body] : bodies.face_start[body + 1]]
            first, last = fill_within(room.u, room.v, faces, False, bits, columns, extents)
        top, bottom = min(top, first), max(bottom, last)
    return crossings, top, bottom, nearest
