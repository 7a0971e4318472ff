"""Compiled silhouettes of closed surfaces: only the contour is drawn, the edges between a face seen and one not seen.

Down a column of pixels, the faces that look towards the source cover a pixel as often as the contour winds around it:
each crossing of the column with a contour edge raises or lowers that number, and the mask is where it is not zero. So
of a mesh only the plane of each face is read (one sign a face), then its edges (one comparison), and only the few
hundred vertices of the contour are projected. Crossings are written as changes, a byte a pixel; a sweep down the rows
adds them up, 64 columns at once, and nothing is sorted. All closed bodies of a scene share one sweep.
What is done lane by lane stands in `lane_kernels`.

Arrays are in blocks of 64 columns, one block after the other, so that the sweep walks along the memory: a mask is
(words, rows + 1) words of 64 columns, the transpose of bit rows. One thread each, no shared state, as in `kernels`.
"""

import math

import numpy as np
from numba import njit

from screwpose.projection.contour import Room
from screwpose.projection.kernels import fill, project
from screwpose.projection.lane_kernels import AT_ONCE, project_edges, sweep, write_places

_PLACES = 4096  # crossings on their way from the lines to the changes: few enough to stay in the nearest cache


@njit(cache=True, nogil=True, error_model="numpy")
def source_of(pixels_from_cad, source_mm):
    """The point (3,) that projects nowhere: the X-ray source, in the frame of the points. NaN where there is none.

    Returns
    -------
    The determinant of the matrix's left block: below 0, what is seen of a face turns the other way in the image.
    """
    P = pixels_from_cad
    a, b, c = P[0, 0], P[0, 1], P[0, 2]
    d, e, f = P[1, 0], P[1, 1], P[1, 2]
    g, h, i = P[2, 0], P[2, 1], P[2, 2]
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    determinant = a * A + b * B + c * C
    x, y, z = P[0, 3], P[1, 3], P[2, 3]
    source_mm[0] = -(A * x + (c * h - b * i) * y + (b * f - c * e) * z) / determinant
    source_mm[1] = -(B * x + (a * i - c * g) * y + (c * d - a * f) * z) / determinant
    source_mm[2] = -(C * x + (b * g - a * h) * y + (a * e - b * d) * z) / determinant
    return determinant


@njit(cache=True, nogil=True, error_model="numpy")
def find_contour(planes, first_face, last_face, edge_faces, source_mm, is_seen, contour):
    """List the edges between a face that looks towards the source and one that does not.

    Parameters
    ----------
    planes : (4, all faces), normal and offset of every face: it looks towards points with ``n . x > offset``.
    first_face, last_face : those of the body (the last not included).
    edge_faces : (E, 2), the face that runs along an edge, and the one that runs against it.
    source_mm : (3,).
    is_seen : (F,) uint8, filled.
    contour : (E + 4,), filled: the edges' numbers, and 0 after them.

    Returns
    -------
    How many there are.
    """
    x, y, z = source_mm
    # One row at a time is contiguous, which a block of columns is not: only then are several faces done at once.
    along_x, along_y = planes[0][first_face:last_face], planes[1][first_face:last_face]
    along_z, offsets = planes[2][first_face:last_face], planes[3][first_face:last_face]
    for face in range(last_face - first_face):
        is_seen[face] = along_x[face] * x + along_y[face] * y + along_z[face] * z > offsets[face]
    count = np.uint64(0)
    for edge in range(edge_faces.shape[0]):
        contour[count] = edge  # no branch: which edges belong is hard to foresee
        count += np.uint64(is_seen[edge_faces[edge, 0]] ^ is_seen[edge_faces[edge, 1]])
    contour[count : count + np.uint64(AT_ONCE - 1)] = 0
    return np.int64(count)


@njit(cache=True, nogil=True, error_model="numpy")
def cross_columns(
    pixels_from_cad, vertices_mm, edge_vertices, edge_faces, is_seen, contour, count, is_mirrored, columns, room
):
    """Project the contour's edges, and write where each crosses the columns of pixels.

    Parameters
    ----------
    contour, count : of `find_contour`.
    is_mirrored : uint8, 1 where the determinant of `source_of` is negative.
    columns : of the image.
    room : `Room`; its changes, raised and ranges are added to.
    """
    lines, reach, order, raised, ranges = room.lines, room.reach, room.order, room.raised, room.ranges
    project_edges(
        pixels_from_cad.ctypes.data, vertices_mm.ctypes.data, edge_vertices.ctypes.data, contour.ctypes.data, count,
        np.float64(columns), lines.ctypes.data, reach.ctypes.data, lines.shape[1],
    )  # fmt: skip
    kept = np.uint64(0)
    for index in range(count):
        order[kept] = index  # no branch: which lines reach the centre of a column is hard to foresee
        kept += np.uint64(reach[0, index] < reach[1, index])
    last_row, stride = np.float64(room.changes.shape[1] - 1), 64 * room.changes.shape[1]
    places = room.places.ctypes.data
    written = 0
    for index in range(kept):
        line = order[index]
        # The cut to an integer rounds down: a row further down, it rounds up. Past an edge by less than 1e-3 px the
        # centre may fall either way.
        u, v, per_column = lines[0, line], lines[1, line] + 1.0, lines[2, line]
        begin, end = np.int64(reach[0, line]), np.int64(reach[1, line])
        rises = np.int64(is_seen[edge_faces[contour[line], 0]] ^ is_mirrored ^ reach[2, line])
        while begin < end:
            word = begin >> 6
            until = min(end, 64 * (word + 1))
            row = v + (begin - u) * per_column
            first = np.int64(min(max(row, 0.0), last_row))
            last = np.int64(min(max(row + (until - 1 - begin) * per_column, 0.0), last_row))
            ranges[word, 0] = min(ranges[word, 0], first, last)
            ranges[word, 1] = max(ranges[word, 1], first + 1, last + 1)
            raised[word, begin & 63] += rises
            raised[word, until - 64 * word] -= rises
            if written + 64 + AT_ONCE > _PLACES:
                _change(room.places[:written], room.changes)
                written = 0
            place = 2 * (word * stride + (begin & 63)) + rises
            for step in range(0, until - begin, AT_ONCE):  # what is written past the end, the next line overwrites
                write_places(
                    places + 4 * (written + step), row + step * per_column, per_column, last_row, place + 2 * step
                )
            written += until - begin
            begin = until
    _change(room.places[:written], room.changes)


@njit(cache=True, nogil=True, error_model="numpy")
def _change(places, changes):
    """Raise or lower the numbers at these places; see `Room`."""
    flat = changes.reshape(-1)
    for index in range(len(places)):
        place = np.uint64(places[index])
        flat[place >> np.uint64(1)] += np.int8(2 * np.int64(place & np.uint64(1)) - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def room_for(bodies, rows, columns):
    """A new `Room` for drawing any of the bodies into images of this size."""
    vertices, faces, edges, words = 0, 0, 0, (columns + 63) >> 6
    for body in range(len(bodies.boxes)):
        vertices = max(vertices, bodies.vertex_start[body + 1] - bodies.vertex_start[body])
        faces = max(faces, bodies.face_start[body + 1] - bodies.face_start[body])
        edges = max(edges, bodies.edge_start[body + 1] - bodies.edge_start[body])
    room = Room(
        np.empty(vertices),
        np.empty(vertices),
        np.empty(3),
        np.empty(faces, dtype=np.uint8),
        np.empty(edges + AT_ONCE, dtype=np.uint32),
        np.empty((3, edges + AT_ONCE)),
        np.empty((3, edges + AT_ONCE), dtype=np.int32),
        np.empty(edges + AT_ONCE, dtype=np.uint32),
        np.empty(_PLACES, dtype=np.uint32),
        np.zeros((words, rows + 1, 64), dtype=np.int8),
        np.zeros((words, 65), dtype=np.int32),
        np.zeros((words, rows + 1), dtype=np.uint64),
        np.empty((words, 2), dtype=np.int64),
    )
    room.ranges[:, 0], room.ranges[:, 1] = rows, 0
    return room


@njit(cache=True, nogil=True, error_model="numpy")
def clear(room):
    """Take the bits of a drawn scene away again."""
    for word in range(room.ranges.shape[0]):
        room.bits[word][room.ranges[word, 0] : room.ranges[word, 1]] = 0
        room.ranges[word, 0], room.ranges[word, 1] = room.bits.shape[1] - 1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _add_up(room):
    """Sweep all changes; False where a pixel may lie under more layers than a byte can count, and nothing is drawn."""
    rows = room.changes.shape[1] - 1
    most = 0
    for word in range(room.ranges.shape[0]):
        if room.ranges[word, 0] < room.ranges[word, 1]:
            of_column = 0
            for column in range(65):
                of_column += room.raised[word, column]
                most = max(most, of_column)
            room.raised[word] = 0
    for word in range(room.ranges.shape[0]):
        first, last = room.ranges[word, 0], min(room.ranges[word, 1], rows + 1)
        if first >= last:
            continue
        if most < 256:
            sweep(room.changes[word, first:].ctypes.data, room.bits[word, first:].ctypes.data, last - first)
        else:
            room.changes[word, first:last] = 0
    return most < 256


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_faces(P, bodies, body, columns, room):
    """Draw a body face by face, and widen the ranges by its box; returns its smallest depth."""
    vertices_mm = bodies.vertices_mm[bodies.vertex_start[body] : bodies.vertex_start[body + 1]]
    nearest = project(P, vertices_mm, room.u, room.v)
    if not nearest > 0.0:
        return nearest
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(vertices_mm)):
        left, right = min(left, room.u[i]), max(right, room.u[i])
        top, bottom = min(top, room.v[i]), max(bottom, room.v[i])
    rows = room.bits.shape[1] - 1
    # Clipped before they become integers: a body far outside must not overflow them.
    first = np.int64(min(max(math.floor(top), 0.0), rows))
    last = np.int64(min(max(math.floor(bottom) + 1.0, 0.0), rows))
    from_word = np.int64(min(max(math.floor(left), 0.0), columns)) >> 6
    to_word = (np.int64(min(max(math.floor(right), -1.0), columns - 1.0)) >> 6) + 1
    for word in range(from_word, to_word):
        room.ranges[word, 0] = min(room.ranges[word, 0], first)
        room.ranges[word, 1] = max(room.ranges[word, 1], last)
    faces = bodies.faces[bodies.face_start[body] : bodies.face_start[body + 1]]
    fill(room.u, room.v, faces, bodies.is_closed[body], room.bits[:, :rows].T, columns)
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def draw_scene(pixels_from_world, world_from_cad, bodies, columns, room):
    """Set the bits of every pixel that any body of a scene covers: closed ones by contour, others face by face.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (B, 4, 4).
    bodies : `contour.Bodies`.
    columns : of the image.
    room : of `room_for`, clear; its bits are set, and its ranges say between which rows.

    Returns
    -------
    The smallest depth of any vertex, mm, or, where all are in front of the source, of their boxes. Where it is not
    positive, the drawing is not finished.
    """
    P = np.empty((3, 4))
    nearest = np.inf
    has_closed = False
    by_contour = True
    body = 0
    while body < world_from_cad.shape[0]:
        for i in range(3):
            for j in range(4):
                total = 0.0
                for k in range(4):
                    total += pixels_from_world[i, k] * world_from_cad[body, k, j]
                P[i, j] = total
        if bodies.is_closed[body] and by_contour:
            depth = P[2, 3]
            for k in range(3):
                depth += min(P[2, k] * bodies.boxes[body, 0, k], P[2, k] * bodies.boxes[body, 1, k])
            vertices_mm = bodies.vertices_mm[bodies.vertex_start[body] : bodies.vertex_start[body + 1]]
            if not depth > 0.0:
                depth = project(P, vertices_mm, room.u, room.v)
            if depth > 0.0:
                has_closed = True
                edges = slice(bodies.edge_start[body], bodies.edge_start[body + 1])
                edge_faces = bodies.edge_faces[edges]
                is_mirrored = np.uint8(source_of(P, room.source_mm) < 0.0)
                count = find_contour(
                    bodies.planes,
                    bodies.face_start[body],
                    bodies.face_start[body + 1],
                    edge_faces,
                    room.source_mm,
                    room.is_seen,
                    room.contour,
                )
                cross_columns(
                    P,
                    vertices_mm,
                    bodies.edge_vertices[edges],
                    edge_faces,
                    room.is_seen,
                    room.contour,
                    count,
                    is_mirrored,
                    columns,
                    room,
                )
        else:
            depth = _draw_faces(P, bodies, body, columns, room)
        nearest = min(nearest, depth)
        if not nearest > 0.0:
            break
        body += 1
        if body == world_from_cad.shape[0] and has_closed and by_contour and not _add_up(room):
            body, by_contour = 0, False  # once more, face by face
    return nearest
