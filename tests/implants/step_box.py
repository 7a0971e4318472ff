"""A STEP file of a box, written entity by entity: no program at hand writes STEP."""

from itertools import product

import numpy as np

_MM = "(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))"


def step_box(size: tuple[float, float, float], inches: bool = False) -> str:
    """A box from the origin to ``size``, in mm or inches."""
    lines: list[str] = []

    def add(text: str) -> str:
        lines.append(f"#{len(lines) + 1}={text};")
        return f"#{len(lines)}"

    def triple(values: object) -> str:
        return "(" + ",".join(f"{float(value):.6f}" for value in np.asarray(values)) + ")"

    def point(values: object) -> str:
        return add(f"CARTESIAN_POINT('',{triple(values)})")

    def direction(values: object) -> str:
        return add(f"DIRECTION('',{triple(values)})")

    corners = {key: np.array(key) * np.array(size) for key in product((0, 1), repeat=3)}
    vertex = {key: add(f"VERTEX_POINT('',{point(place)})") for key, place in corners.items()}
    edge: dict[tuple[tuple[int, ...], tuple[int, ...]], str] = {}
    for start, end in product(corners, repeat=2):
        if sum(end) - sum(start) == 1 and np.abs(np.subtract(end, start)).sum() == 1:
            vector = add(f"VECTOR('',{direction(np.subtract(end, start))},1.0)")
            line = add(f"LINE('',{point(corners[start])},{vector})")
            edge[start, end] = add(f"EDGE_CURVE('',{vertex[start]},{vertex[end]},{line},.T.)")
    faces = []
    for axis, side in product(range(3), (0, 1)):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        loop = []
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
            key = [0, 0, 0]
            key[axis], key[u], key[v] = side, a, b
            loop.append(tuple(key))
        if side == 0:
            loop.reverse()
        oriented = [
            add(
                f"ORIENTED_EDGE('',*,*,{edge[a, b]},.T.)"
                if (a, b) in edge
                else f"ORIENTED_EDGE('',*,*,{edge[b, a]},.F.)"
            )
            for a, b in zip(loop, loop[1:] + loop[:1], strict=True)
        ]
        bound = add(f"FACE_OUTER_BOUND('',{add('EDGE_LOOP(' + repr('') + ',(' + ','.join(oriented) + '))')},.T.)")
        normal = np.eye(3)[axis] * (2 * side - 1)
        placement = add(
            f"AXIS2_PLACEMENT_3D('',{point(corners[loop[0]])},{direction(normal)},{direction(np.eye(3)[u])})"
        )
        plane = add(f"PLANE('',{placement})")
        faces.append(add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    brep = add(f"MANIFOLD_SOLID_BREP('',{add('CLOSED_SHELL(' + repr('') + ',(' + ','.join(faces) + '))')})")
    length = add(_MM)
    if inches:
        dimensions = add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        measure = add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{length})")
        length = add(f"(CONVERSION_BASED_UNIT('INCH',{measure}) LENGTH_UNIT() NAMED_UNIT({dimensions}))")
    angle = add("(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.))")
    solid = add("(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT())")
    fuzz = add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),{length},'distance_accuracy_value','')")
    context = add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3) "
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({fuzz})) GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid})) "
        "REPRESENTATION_CONTEXT('',''))"
    )
    shape = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({brep}),{context})")
    application = add("APPLICATION_CONTEXT('automotive design')")
    stage = add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product_ = add(f"PRODUCT('box','box','',({stage}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',{product_})")
    stage = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',{formation},{stage})")
    definition_shape = add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    add(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    header = (
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        "FILE_NAME('box','2026-01-01T00:00:00',(''),(''),'','','');\n"
        "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
    )
    return header + "\n".join(lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
