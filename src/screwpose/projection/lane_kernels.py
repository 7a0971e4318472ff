"""Loops over explicit vectors, for `contour_kernels`: where the compiler does not see that lanes are independent.

Arrays come as addresses (`array.ctypes.data`), and nothing checks an index: each function says how much it touches.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

AT_ONCE = 4
"""How many edges are projected, and how many crossings written, at once."""

_WORD, _SHORT, _REAL = ir.IntType(64), ir.IntType(32), ir.DoubleType()
_SHORTS, _REALS = ir.VectorType(_SHORT, AT_ONCE), ir.VectorType(_REAL, AT_ONCE)
_NONE = ir.Constant(_REALS, None)
_CHANGES = ir.VectorType(ir.IntType(8), 64)


def _at(builder, address, index, kind, size):
    """A pointer to element `index` (a number or a value) of an array at an address."""
    index = _WORD(index) if isinstance(index, int) else index
    return builder.inttoptr(builder.add(address, builder.mul(index, _WORD(size))), kind.as_pointer())


def _splat(builder, value, kind):
    """A vector with the same value in every lane."""
    nothing = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(nothing, value, _SHORT(0))
    return builder.shuffle_vector(first, nothing, ir.Constant(_SHORTS, None))


def _between(builder, values, top):
    """Clipped to [0, top]."""
    values = builder.select(builder.fcmp_ordered(">", values, _NONE), values, _NONE)
    return builder.select(builder.fcmp_ordered("<", values, top), values, top)


@intrinsic
def sweep(_context, _changes, _bits, _count):
    """Add up `count` rows of 64 changes (int8); clear them, and set the bits (uint64 a row) where the sum is not 0."""

    def code(_c, builder, _s, arguments):
        changes, bits, count = arguments
        none = ir.Constant(_CHANGES, None)
        around = cgutils.alloca_once_value(builder, none)
        with cgutils.for_range(builder, count) as row:
            change = _at(builder, changes, row.index, _CHANGES, 64)
            total = builder.add(builder.load(around), builder.load(change, align=1))
            builder.store(total, around)
            builder.store(none, change, align=1)
            covered = builder.bitcast(builder.icmp_unsigned("!=", total, none), _WORD)
            place = _at(builder, bits, row.index, _WORD, 8)
            builder.store(builder.or_(builder.load(place), covered), place)
        return _WORD(0)

    return types.int64(types.int64, types.int64, types.int64), code


@intrinsic
def project_edges(_context, _matrix, _vertices_mm, _edges, _numbers, _count, _columns, _lines, _reach, _stride):
    """Project edges, four at once.

    Parameters
    ----------
    matrix : (3, 4), pixels_from_cad.
    vertices_mm : (N, 3).
    edges : (E, 2), uint32.
    numbers : uint32, those of the edges to be projected; read to the next multiple of four.
    count : how many.
    columns : float64, of the image.
    lines : (3, stride), filled: u and v of the edge's first vertex, and v by u.
    reach : (3, stride), int32, filled: the first column right of the edge's left end, that of its right end, and 1
        where its first vertex is the right one.
    stride : at least `count`, rounded up to a multiple of four.
    """

    def code(_c, builder, _s, arguments):
        matrix, vertices, edges, numbers, count, columns, lines, reach, stride = arguments
        may_fuse = ("contract",)

        def entry(row, column):
            return _splat(builder, builder.load(_at(builder, matrix, 4 * row + column, _REAL, 8)), _REALS)

        rows = [[entry(row, column) for column in range(4)] for row in range(3)]
        width = _splat(builder, columns, _REALS)

        def number(address, index):
            return builder.zext(builder.load(_at(builder, address, index, _SHORT, 4)), _WORD)

        def coordinate(places, axis):
            gathered = ir.Constant(_REALS, ir.Undefined)
            for lane, place in enumerate(places):
                value = builder.load(_at(builder, vertices, builder.add(place, _WORD(axis)), _REAL, 8))
                gathered = builder.insert_element(gathered, value, _SHORT(lane))
            return gathered

        def projected(places):
            point = [coordinate(places, axis) for axis in range(3)]
            u, v, depth = (
                _chain(builder, [builder.fmul(a, x, may_fuse) for a, x in zip(row, point, strict=False)], row[3])
                for row in rows
            )
            per_depth = builder.fdiv(ir.Constant(_REALS, [1.0] * AT_ONCE), depth)
            return builder.fmul(u, per_depth), builder.fmul(v, per_depth)

        def next_column(u):
            u = _between(builder, u, width)
            cut = builder.fptosi(u, _SHORTS)
            return builder.add(cut, builder.zext(builder.fcmp_ordered("<", builder.sitofp(cut, _REALS), u), _SHORTS))

        blocks = builder.lshr(builder.add(count, _WORD(AT_ONCE - 1)), _WORD(2))
        with cgutils.for_range(builder, blocks) as block:
            first = builder.mul(block.index, _WORD(AT_ONCE))
            taken = [number(numbers, builder.add(first, _WORD(lane))) for lane in range(AT_ONCE)]
            ends = []
            for end in range(2):
                vertex = [number(edges, builder.add(builder.mul(edge, _WORD(2)), _WORD(end))) for edge in taken]
                ends.append(projected([builder.mul(one, _WORD(3)) for one in vertex]))
            (u, v), (to_u, to_v) = ends
            slope = builder.fdiv(builder.fsub(to_v, v), builder.fsub(to_u, u))
            is_back = builder.fcmp_ordered("<", to_u, u)
            left, right = builder.select(is_back, to_u, u), builder.select(is_back, u, to_u)
            for row, reals in enumerate((u, v, slope)):
                place = builder.add(first, builder.mul(stride, _WORD(row)))
                builder.store(reals, _at(builder, lines, place, _REALS, 8), align=8)
            for row, shorts in enumerate((next_column(left), next_column(right), builder.zext(is_back, _SHORTS))):
                place = builder.add(first, builder.mul(stride, _WORD(row)))
                builder.store(shorts, _at(builder, reach, place, _SHORTS, 4), align=4)
        return _WORD(0)

    word = types.int64
    return word(word, word, word, word, word, types.float64, word, word, word), code


def _chain(builder, products, total):
    """The sum of products, the last first, each of which may be fused with its sum."""
    for product in reversed(products):
        total = builder.fadd(product, total, ("contract",))
    return total


@intrinsic
def write_places(_context, _places, _row, _per_column, _last_row, _first):
    """Write where a line crosses four columns side by side: uint32, ``first + 2 (64 row + column)``.

    Parameters
    ----------
    row, per_column : where it crosses the first of them, cut down and clipped to [0, last_row], and its slope.
    """

    def code(_c, builder, _s, arguments):
        places, row, per_column, last_row, first = arguments
        steps = builder.fmul(
            _splat(builder, per_column, _REALS), ir.Constant(_REALS, [float(lane) for lane in range(AT_ONCE)])
        )
        rows = builder.fadd(_splat(builder, row, _REALS), steps)
        rows = builder.fptosi(_between(builder, rows, _splat(builder, last_row, _REALS)), _SHORTS)
        columns = ir.Constant(_SHORTS, [2 * lane for lane in range(AT_ONCE)])
        start = builder.add(_splat(builder, builder.trunc(first, _SHORT), _SHORTS), columns)
        whole = builder.add(builder.shl(rows, ir.Constant(_SHORTS, [7] * AT_ONCE)), start)
        builder.store(whole, builder.inttoptr(places, _SHORTS.as_pointer()), align=4)
        return _WORD(0)

    word, real = types.int64, types.float64
    return word(word, real, real, real, word), code
