"""Mesh files: what other libraries or a hand wrote is read as they meant it; what is broken is refused in words."""

import struct
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from screwpose.errors import MeshError, OutputError
from screwpose.implants import Mesh, make_screw, read_mesh, reduced, transformed, write_stl
from tests.data import shared_data
from tests.implants.step_box import step_box

SIZE = (2.0, 3.0, 5.0)


@pytest.fixture
def box() -> trimesh.Trimesh:
    """A closed box with a corner at the origin: volume 30, surface 62."""
    box = trimesh.creation.box(SIZE)
    box.apply_translation(np.array(SIZE) / 2.0)
    return box


def volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.triangles_mm, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def area(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.triangles_mm, 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def assert_is_box(mesh: Mesh, scale: float = 1.0) -> None:
    assert mesh.vertices_mm.shape == (8, 3)
    assert mesh.vertices_mm.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    np.testing.assert_allclose(mesh.vertices_mm.min(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(mesh.vertices_mm.max(axis=0), scale * np.array(SIZE), rtol=1e-6)
    np.testing.assert_allclose(volume(mesh), 30.0 * scale**3, rtol=1e-5)
    np.testing.assert_allclose(area(mesh), 62.0 * scale**2, rtol=1e-5)


def exported(box: trimesh.Trimesh, path: Path, **options: object) -> Path:
    data = box.export(file_type=options.pop("file_type", path.suffix[1:]), **options)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.stl", {}),
        ("b.STL", {"file_type": "stl_ascii"}),
        ("c.obj", {}),
        ("d.ply", {"encoding": "binary"}),
        ("e.ply", {"encoding": "ascii"}),
    ],
)
def test_reads_what_trimesh_writes(box: trimesh.Trimesh, tmp_path: Path, name: str, options: dict[str, object]) -> None:
    assert_is_box(read_mesh(exported(box, tmp_path / name, **options)))


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("file_format", ["vtk42", "vtk51", "ply", "stl"])
def test_reads_what_meshio_writes(box: trimesh.Trimesh, tmp_path: Path, file_format: str, binary: bool) -> None:
    path = tmp_path / f"box.{file_format[:3]}"
    cells = [("triangle", np.asarray(box.faces))]
    meshio.write(path, meshio.Mesh(np.asarray(box.vertices), cells), file_format=file_format, binary=binary)
    assert_is_box(read_mesh(path))


@pytest.mark.parametrize("file_format", ["vtk42", "vtk51"])
def test_reads_quads_of_an_unstructured_grid(tmp_path: Path, file_format: str) -> None:
    corners = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], dtype=float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    meshio.write(tmp_path / "q.vtk", meshio.Mesh(corners, [("quad", quads)]), file_format=file_format, binary=True)
    assert_is_box(read_mesh(tmp_path / "q.vtk"))


POLYDATA = """# vtk DataFile Version 4.2
SPACE=LPS
{encoding}
DATASET POLYDATA
FIELD FieldData 1
note 1 2 float
{field}
POINTS 8 float
{points}
METADATA
INFORMATION 0

POLYGONS 5 {size}
{polygons}
TRIANGLE_STRIPS 1 5
{strip}
POINT_DATA 8
"""
_CORNERS = [(x, y, z) for x in (0.0, 2.0) for y in (0.0, 3.0) for z in (0.0, 5.0)]
_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
_STRIP = (1, 5, 3, 7)  # the side z = 5, seen from outside counter-clockwise


def polydata(binary: bool) -> bytes:
    def block(values: object, code: str) -> bytes:
        flat = np.asarray(values).ravel()
        return struct.pack(f">{len(flat)}{code}", *flat) if binary else " ".join(map(str, flat)).encode()

    blocks = {
        b"{encoding}": b"BINARY" if binary else b"ASCII",
        b"{field}": block([1.5, 2.5], "f"),
        b"{points}": block(_CORNERS, "f"),
        b"{size}": b"25",
        b"{polygons}": block([(4, *quad) for quad in _QUADS], "i"),
        b"{strip}": block((4, *_STRIP), "i"),
    }
    data = POLYDATA.encode()
    for key, value in blocks.items():
        data = data.replace(key, value)
    return data


@pytest.mark.parametrize("binary", [False, True])
def test_reads_legacy_polydata_with_quads_and_strips(tmp_path: Path, binary: bool) -> None:
    (tmp_path / "p.vtk").write_bytes(polydata(binary))
    assert_is_box(read_mesh(tmp_path / "p.vtk"))


def test_reads_polydata_of_version_5(tmp_path: Path) -> None:
    offsets = " ".join(str(4 * k) for k in range(6))
    text = (
        "# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\nPOINTS 8 double\n"
        + " ".join(str(v) for corner in _CORNERS for v in corner)
        + f"\nPOLYGONS 6 20\nOFFSETS vtktypeint64\n{offsets}\nCONNECTIVITY vtktypeint64\n"
        + " ".join(str(i) for quad in _QUADS for i in quad)
    )
    (tmp_path / "p.vtk").write_text(text)
    mesh = read_mesh(tmp_path / "p.vtk")
    assert len(mesh.faces) == 10
    np.testing.assert_allclose(area(mesh), 62.0 - 6.0)  # without the side z = 5


def test_obj_takes_negative_indices_groups_and_continued_lines(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text(
        "# a tetrahedron\nmtllib none.mtl\no one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1 1.0\nvn 0 0 1\n"
        "g sides\nf -4/1/1 -2//1 -3\nf 1 2 4\nf 2 3 \\\n4\nf 1 4 3\n"
    )
    mesh = read_mesh(tmp_path / "t.obj")
    assert len(mesh.vertices_mm) == 4
    np.testing.assert_allclose(volume(mesh), 1.0 / 6.0)


@pytest.mark.parametrize("tilt_rad", [0.0, 1.1])
def test_a_concave_polygon_keeps_its_notch(tmp_path: Path, tilt_rad: float) -> None:
    """A rod channel drawn as one U-shaped face: a fan of triangles would cover the channel."""
    u = np.array([[0, 0], [6, 0], [6, 4], [5, 4], [5, 1], [1, 1], [1, 4], [0, 4]], dtype=float)
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    points = np.column_stack([u, np.zeros(8)]) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    (tmp_path / "u.obj").write_text("\n".join([*lines, "f 1 2 3 4 5 6 7 8"]))
    mesh = read_mesh(tmp_path / "u.obj")
    np.testing.assert_allclose(area(mesh), 12.0)  # 6 x 4 less the channel of 4 x 3
    normal = np.cross(
        mesh.triangles_mm[:, 1] - mesh.triangles_mm[:, 0], mesh.triangles_mm[:, 2] - mesh.triangles_mm[:, 0]
    )
    assert np.all(normal @ [0, -s, c] > 0.0)


def test_a_concave_quad_is_split_along_its_inner_diagonal(tmp_path: Path) -> None:
    (tmp_path / "arrow.obj").write_text("v 2 2 0\nv 0 1 0\nv 1 1 0\nv 1 0 0\nf 4 1 2 3")
    np.testing.assert_allclose(area(read_mesh(tmp_path / "arrow.obj")), 1.0)  # shoelace by hand


def test_ply_with_mixed_polygons_colours_and_big_endian(tmp_path: Path) -> None:
    header = (
        b"ply\nformat binary_big_endian 1.0\ncomment c\nelement vertex 5\nproperty float x\nproperty float y\n"
        b"property float z\nproperty uchar red\nelement face 5\nproperty uchar flags\n"
        b"property list uchar int vertex_indices\nend_header\n"
    )
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
    faces = [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    body = b"".join(struct.pack(">fffB", *point, 255) for point in points)
    body += b"".join(struct.pack(f">BB{len(face)}i", 7, len(face), *face) for face in faces)
    (tmp_path / "pyramid.ply").write_bytes(header + body)
    np.testing.assert_allclose(volume(read_mesh(tmp_path / "pyramid.ply")), 1.0 / 3.0)


@pytest.mark.parametrize("inches", [False, True])
def test_step_comes_out_in_mm_whatever_its_unit(tmp_path: Path, inches: bool) -> None:
    (tmp_path / "box.step").write_text(step_box(SIZE, inches=inches))
    assert_is_box(read_mesh(tmp_path / "box.step"), scale=25.4 if inches else 1.0)


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("inch", 25.4)])
def test_units(box: trimesh.Trimesh, tmp_path: Path, unit: str, mm: float) -> None:
    assert_is_box(read_mesh(exported(box, tmp_path / "box.stl"), unit=unit), scale=mm)


def test_a_binary_stl_whose_header_says_solid_is_read(box: trimesh.Trimesh, tmp_path: Path) -> None:
    data = box.export(file_type="stl")
    (tmp_path / "a.stl").write_bytes(b"solid made by a CAD".ljust(80) + data[80:])
    assert_is_box(read_mesh(tmp_path / "a.stl"))


def test_unused_vertices_go_and_order_stays(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 99 99 99\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv -0.0 0 0\nv 0 0 1\nf 2 3 4\nf 5 6 3")
    mesh = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.vertices_mm, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 3, 1]])


# --- what is refused

VTK = b"# vtk DataFile Version 3.0\nt\nASCII\n"


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.dxf", b"x", r"a\.dxf: '\.dxf' is no mesh format that can be read; expected \.stl .* as STL"),
        ("a.stl", b"", r"the mesh file is empty \(0 bytes\)"),
        ("a.stl", bytes(84), "the mesh has no faces"),
        ("a.stl", b"solid a\nendsolid a\n", "the mesh has no faces"),
        ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "cut short: 1 facets begin, 0 end"),
        ("a.stl", b"short", r"cut short: it holds 5 bytes"),
        ("a.stl", bytes(80) + b"\x02\0\0\0" + bytes(50), r"holds 134 bytes, its 2 triangles need 184.*copy it again"),
        ("a.stl", bytes(84) + b"garbage", "not an STL file: 7 bytes follow after the 0 triangles"),
        ("a.obj", b"v 0 0\nf 1 2 3", r"line 1 of the OBJ file cannot be read: 'v 0 0'"),
        ("a.obj", b"v 0 0 zero\n", r"line 1 .*'v 0 0 zero'"),
        ("a.obj", b"v 0 0 0\nf 1 2 3", "asks for vertex 3, but it has 1"),
        ("a.obj", b"v 0 0 0\nf 0 1 1", "vertex 0, but they count from 1"),
        ("a.obj", b"\x89PNG\r\n", "the mesh has no faces"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n", "has no 'y'"),
        ("a.ply", b"plx", "cut short or garbled"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n",
            "3 of 'vertex' are announced, 2 are there",
        ),
        ("a.vtk", b"<?xml version='1.0'?>", "not a legacy VTK file; expected '# vtk DataFile'"),
        ("a.vtk", VTK + b"DATASET STRUCTURED_POINTS\n", "holds STRUCTURED_POINTS"),
        ("a.vtk", VTK + b"DATASET POLYDATA\nPOINTS 2 float\n0 0 0 1", "6 numbers are announced"),
        ("a.vtk", VTK + b"DATASET POLYDATA\n", "POINTS are missing"),
        ("a.step", b"hello", "not a STEP file"),
        ("a.stp", b"ISO-10303-21;\nHEADER;", "the STEP file is cut short"),
    ],
)  # fmt: skip
def test_broken_files_are_refused_in_words(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(MeshError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert caught.value.file == tmp_path / name


def test_every_truncation_is_refused(box: trimesh.Trimesh, tmp_path: Path) -> None:
    """Whatever byte a copy stops at: an error of ours, never another and never half a mesh."""
    whole = {
        ".stl": box.export(file_type="stl"),
        ".ply": box.export(file_type="ply"),
        ".vtk": polydata(binary=True)[: -len("\nPOINT_DATA 8\n")],
        ".step": step_box(SIZE).encode().rstrip(),
    }
    for suffix, data in whole.items():
        path = tmp_path / f"a{suffix}"
        for length in np.linspace(0, len(data) - 1, 40).astype(int):
            path.write_bytes(data[:length])
            with pytest.raises(MeshError):
                read_mesh(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"none\.stl: the mesh cannot be read \(No such file or directory\)"):
        read_mesh(tmp_path / "none.stl")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_not_finite_are_refused(box: trimesh.Trimesh, tmp_path: Path, value: float) -> None:
    data = bytearray(box.export(file_type="stl"))
    struct.pack_into("<f", data, 84 + 50 * 3 + 12, value)
    (tmp_path / "a.stl").write_bytes(data)
    with pytest.raises(MeshError, match="1 of 12 faces have a coordinate that is not finite, the first is face 3"):
        read_mesh(tmp_path / "a.stl")


def test_a_volume_mesh_is_refused(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    meshio.write(tmp_path / "a.vtk", meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]), file_format="vtk42")
    with pytest.raises(MeshError, match=r"cells of type \[10\], which are no flat faces.*Extract the surface"):
        read_mesh(tmp_path / "a.vtk")


def test_a_wrong_unit_is_refused(box: trimesh.Trimesh, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="unit: the unit 'furlong' is not known; expected mm, cm, m, inch"):
        read_mesh(exported(box, tmp_path / "a.stl"), unit="furlong")
    (tmp_path / "a.step").write_text(step_box(SIZE))
    with pytest.raises(MeshError, match="the unit 'inch' was given for a STEP file, which states its own"):
        read_mesh(tmp_path / "a.step", unit="inch")


# --- writing, moving, reducing


def test_trimesh_reads_what_is_written(tmp_path: Path) -> None:
    mesh = make_screw().mesh
    write_stl(mesh, tmp_path / "screw.stl")
    other = trimesh.load_mesh(tmp_path / "screw.stl")
    assert other.is_watertight
    np.testing.assert_allclose(other.volume, volume(mesh), rtol=1e-6)
    np.testing.assert_allclose(other.bounds, [mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)], atol=1e-5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["screw.stl"]  # no temporary file is left


def test_a_write_that_fails_says_so_and_leaves_the_old_file(tmp_path: Path) -> None:
    mesh = make_screw().mesh
    with pytest.raises(OutputError, match=r"none/a\.stl: the file cannot be written"):
        write_stl(mesh, tmp_path / "none" / "a.stl")
    (tmp_path / "a.stl").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        write_stl(mesh, tmp_path / "a.stl")
    assert [path.name for path in tmp_path.iterdir()] == ["a.stl"]


def test_transformed_by_hand() -> None:
    mesh = Mesh(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([[0, 1, 2]]))
    quarter_about_z = np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]], dtype=float)
    np.testing.assert_array_equal(
        transformed(mesh, quarter_about_z).vertices_mm, [[10, 21, 30], [9, 20, 30], [10, 20, 31]]
    )


@pytest.mark.parametrize(
    ("faces", "volume_share", "extent_mm"), [(4000, 0.002, 0.05), (2000, 0.01, 0.3), (1000, 0.05, 0.5)]
)
def test_reduced_keeps_to_its_budget_and_the_shape(faces: int, volume_share: float, extent_mm: float) -> None:
    mesh = make_screw().mesh
    once, again = reduced(mesh, faces), reduced(mesh, faces)
    assert 0.9 * faces <= len(once.faces) <= faces
    np.testing.assert_array_equal(once.vertices_mm, again.vertices_mm)
    np.testing.assert_array_equal(once.faces, again.faces)
    np.testing.assert_allclose(volume(once), volume(mesh), rtol=volume_share)
    np.testing.assert_allclose(np.ptp(once.vertices_mm, axis=0), np.ptp(mesh.vertices_mm, axis=0), atol=extent_mm)


def test_reduced_stops_before_it_spoils_a_shape() -> None:
    """The library alone goes to 2046 faces and 69 % of the volume here."""
    mesh = read_mesh(shared_data("jtml_biplane/femur0.stl"))
    small = reduced(mesh, 2000)
    assert len(small.faces) < 5000
    np.testing.assert_allclose(volume(small), volume(mesh), rtol=0.05)
    np.testing.assert_allclose(np.ptp(small.vertices_mm, axis=0), np.ptp(mesh.vertices_mm, axis=0), atol=1.6)


def test_reduced_returns_a_small_mesh_itself_and_refuses_nonsense() -> None:
    mesh = make_screw().mesh
    assert reduced(mesh, len(mesh.faces)) is mesh
    with pytest.raises(ValueError, match="faces must be 4 or more, not 3"):
        reduced(mesh, 3)


def test_real_meshes_agree_with_trimesh() -> None:
    for name in ("jtml_biplane/tibia0.stl", "screws_lassoan/scaled_625x45.stl"):
        path = shared_data(name)
        mesh, other = read_mesh(path), trimesh.load_mesh(path)
        assert len(mesh.vertices_mm) == len(other.vertices)
        np.testing.assert_allclose(mesh.triangles_mm.min(axis=(0, 1)), other.bounds[0], atol=1e-6)
        np.testing.assert_allclose(area(mesh), other.area, rtol=1e-6)
