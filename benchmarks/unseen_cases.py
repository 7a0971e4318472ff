"""Cases that share no code with our simulator: are we right where neither images nor implants are our own?

    SCREWPOSE_DATA=../shared/data python benchmarks/unseen_cases.py --kind ct --count 20 --seed 7001 -o unseen-ct
    screwpose bench --cases unseen-ct --method default --workers 1 -o unseen-ct-out

`ct` marches rays through a real CT of a lumbar spine and adds screws in three energies, with scatter, blur, noise and
a display curve of this script. `real` multiplies screws into the sixteen biplane X-rays of a knee implant, in its true
calibrations, with the images' own blur and noise. The implants are threaded screws with slotted towers, modelled here,
and those of the PedicleScrewSimulator with a tower put on: the X-ray shows their pieces closed and united, the case has
the mesh so, or (`-raw`) as it was published, in open pieces. Marks are the true landmarks with noise, labels are
shuffled in each view, and in a third of the cases of more than two screws one is unmarked in a view. Writes one case
folder a case with its truth, and `unseen.json` with what was drawn.
"""

import argparse
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import trimesh
from numba import njit
from PIL import Image
from rich.console import Console
from rich.progress import track
from scipy import ndimage
from scipy.spatial.transform import Rotation

from screwpose._types import FloatArray
from screwpose.files import write_json
from screwpose.images.encoding import encode_png

# keV 40, 60, 80: share of the signal, and per mm of water, of bone's part beyond water at 1000 HU, and of titanium.
_SHARES, _WATER = np.array([0.35, 0.40, 0.25]), np.array([0.0268, 0.0206, 0.0184])
_BONE, _TITANIUM = np.array([0.034, 0.0215, 0.0185]), np.array([0.98, 0.33, 0.166])
# Of the CT: voxels of vertebral bodies' middles, T12 to L5, and the middle of the spine in x and of the bodies' in y.
_LEVELS_K, _SPINE_I, _BODY_J = (106, 97, 86, 73, 62, 50), 59, 45
_CT_STRIDE, _CT_STEP_MM = 4, 1.5  # 3 mm voxels show no more
_APART_MM, _RAYS = 18.0, 3  # between axes: towers have up to 17; rays a pixel, each way
_SKEWED = 0.02  # structure that the CT's voxels have lost, in the logarithm


@dataclass(frozen=True, eq=False)
class Design:
    """An implant: the solid that is X-rayed, the mesh that the case gets, its landmarks and rod direction, CAD, mm."""

    name: str
    solid: trimesh.Trimesh
    mesh: trimesh.Trimesh
    tip: FloatArray
    center: FloatArray
    rod: FloatArray
    length_mm: float  # of the shank, tip to head
    reach_mm: float  # from the tip to the tower's end


@dataclass(frozen=True, eq=False)
class View:
    """A camera: P, such that w is in mm, and the image's (width, height)."""

    name: str
    projection: FloatArray
    size: tuple[int, int]


@njit(cache=True)
def _add_lengths(points: FloatArray, faces: Any, sums: FloatArray) -> None:
    """Add each face's signed depth w at every ray inside it; (N, 3) points are u, v of the fine grid and 1 / w."""
    rows, columns = sums.shape
    for face in range(len(faces)):
        a, b, c = points[faces[face, 0]], points[faces[face, 1]], points[faces[face, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        first, last = max(0, int(np.ceil(min(a[1], b[1], c[1])))), min(rows - 1, int(max(a[1], b[1], c[1])))
        left, right = max(0, int(np.ceil(min(a[0], b[0], c[0])))), min(columns - 1, int(max(a[0], b[0], c[0])))
        for row in range(first, last + 1):
            for column in range(left, right + 1):
                within = 0
                for p, q in ((a, b), (b, c), (c, a)):
                    # The same arithmetic for both faces of an edge, so that a ray is in one of them.
                    turned = p[0] > q[0] or (p[0] == q[0] and p[1] > q[1])
                    s, t = (q, p) if turned else (p, q)
                    side = (t[0] - s[0]) * (row - s[1]) - (t[1] - s[1]) * (column - s[0]) >= 0.0
                    within += (side != turned) == (area > 0.0)
                if within == 3:
                    u, v = column - a[0], row - a[1]
                    of_b = (u * (c[1] - a[1]) - v * (c[0] - a[0])) / area
                    of_c = ((b[0] - a[0]) * v - (b[1] - a[1]) * u) / area
                    depth = 1.0 / (a[2] + of_b * (b[2] - a[2]) + of_c * (c[2] - a[2]))
                    sums[row, column] += depth if area > 0.0 else -depth


def projected(view: View, points_mm: FloatArray) -> FloatArray:
    """(N, 3): u, v in px and w in mm."""
    uvw = points_mm @ view.projection[:, :3].T + view.projection[:, 3]
    return np.column_stack([uvw[:, :2] / uvw[:, 2:], uvw[:, 2]])


def directions(view: View, u: FloatArray, v: FloatArray) -> FloatArray:
    """(..., 3): along the rays of pixels, from the source, as long as w grows by 1."""
    return np.stack(np.broadcast_arrays(u, v, 1.0), axis=-1) @ np.linalg.inv(view.projection[:, :3]).T


def path_lengths(view: View, solids: list[trimesh.Trimesh]) -> FloatArray:
    """Millimetres within the solids along each of `_RAYS` x `_RAYS` rays a pixel, (rows * _RAYS, columns * _RAYS)."""
    width, height = view.size
    total = np.zeros((height * _RAYS, width * _RAYS))
    for solid in solids:
        uvw = projected(view, np.asarray(solid.vertices))
        fine = np.column_stack([(uvw[:, :2] + 0.5) * _RAYS - 0.5, 1.0 / uvw[:, 2]])
        _add_lengths(fine, np.asarray(solid.faces), total)
    u, v = ((np.arange(n * _RAYS) + 0.5) / _RAYS - 0.5 for n in view.size)
    return np.abs(total) * np.linalg.norm(directions(view, u[None], v[:, None]), axis=-1)


def through_metal(lengths_mm: FloatArray, per_mm: float) -> FloatArray:
    """Mean transmission of each pixel."""
    rows, columns = lengths_mm.shape
    rays = np.exp(-per_mm * lengths_mm).reshape(rows // _RAYS, _RAYS, columns // _RAYS, _RAYS)
    return np.asarray(rays.mean(axis=(1, 3)))


def closed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The thick pieces of a mesh, their holes coned shut, as one solid."""
    pieces = []
    for piece in mesh.split(only_watertight=False):
        edges = piece.edges[trimesh.grouping.group_rows(piece.edges_sorted, require_count=1)]
        if piece.extents.min() < 1.0:
            continue
        vertices, faces = [piece.vertices], [piece.faces]
        for loop in trimesh.graph.connected_components(edges):
            apex = len(piece.vertices) + len(vertices) - 1
            vertices.append(piece.vertices[loop].mean(axis=0, keepdims=True))
            faces.append([(q, p, apex) for p, q in edges if p in loop])
        pieces.append(trimesh.Trimesh(np.vstack(vertices), np.vstack(faces)))
    return trimesh.boolean.union(pieces, engine="manifold")


def threaded_shank(rng: np.random.Generator, length_mm: float, radius_mm: float) -> trimesh.Trimesh:
    """A right-handed thread about z on a core, tip in the origin."""
    pitch_mm, leads = rng.uniform(1.4, 2.4), int(rng.integers(1, 3))
    depth_mm, turns = rng.uniform(0.6, 1.1), np.arange(40) / 40
    z = np.linspace(0.0, length_mm + 3.0, int((length_mm + 3.0) / pitch_mm * 8))[1:]
    phase = (z[:, None] / pitch_mm - leads * turns) % 1.0
    taper = np.minimum(1.0, (z / rng.uniform(5.0, 10.0)) ** 0.7)
    radii = (radius_mm - depth_mm * np.clip(3.0 * np.abs(phase - 0.5) - 0.25, 0.0, 1.0)) * taper[:, None]
    angles = 2 * np.pi * turns
    rings = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.broadcast_to(z[:, None], radii.shape)], -1)
    rows, k = len(z), np.arange(40)
    first, second = k + 40 * np.arange(rows - 1)[:, None], (k + 1) % 40 + 40 * np.arange(rows - 1)[:, None]
    sides = np.stack([first, second, second + 40, first, second + 40, first + 40], -1).reshape(-1, 3)
    tip, top = rows * 40, rows * 40 + 1
    ends = [((a + 1) % 40, a, tip) for a in k] + [(tip - 40 + a, tip - 40 + (a + 1) % 40, top) for a in k]
    return trimesh.Trimesh(np.vstack([rings.reshape(-1, 3), [[0, 0, 0], [0, 0, z[-1]]]]), np.vstack([sides, ends]))


def tube(rng: np.random.Generator, from_mm: float, to_mm: float, inner_mm: float, outer_mm: float) -> trimesh.Trimesh:
    """A tower about z with rod slots along x, and nearly always a window or a notch on one side."""
    length, middle = to_mm - from_mm, 0.5 * (from_mm + to_mm)
    tower = trimesh.creation.annulus(inner_mm, outer_mm, length, sections=64)
    tower.apply_translation([0, 0, middle])
    slot_mm = rng.uniform(0.3, 0.75) * length
    cuts = [trimesh.creation.box([40.0, rng.uniform(5.0, 6.5), slot_mm])]
    cuts[0].apply_translation([0, 0, from_mm + 0.5 * slot_mm - 1.0])
    if rng.random() < 0.8:
        cuts.append(trimesh.creation.box([rng.uniform(3.0, 6.0), 20.0, rng.uniform(6.0, 20.0)]))
        cuts[1].apply_translation([0, 10.0, to_mm - (0.0 if rng.random() < 0.5 else 0.15 * length)])
    return trimesh.boolean.difference([tower, *cuts], engine="manifold")


def own_design(rng: np.random.Generator) -> Design:
    """Thread, tulip and tower, in a CAD frame that lies anywhere."""
    length, radius = float(rng.choice([35, 40, 45, 50, 55])), rng.uniform(2.4, 3.7)
    outer, end = rng.uniform(6.2, 7.5), length + 14.0 + rng.uniform(50.0, 105.0)
    tulip = trimesh.creation.cylinder(outer, 13.0, sections=64)
    tulip.apply_translation([0, 0, length + 6.5])
    channel = trimesh.creation.box([40.0, 5.6, 12.0])
    channel.apply_translation([0, 0, length + 11.5])
    tulip = trimesh.boolean.difference([tulip, channel], engine="manifold")
    tower = tube(rng, length + 9.0, end, outer - rng.uniform(1.0, 1.8), outer + rng.uniform(0.1, 0.9))
    solid = trimesh.boolean.union([threaded_shank(rng, length, radius), tulip, tower], engine="manifold")
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(0.0, 20.0, 3)
    solid.apply_transform(frame)
    tip, center = frame[:3, 3], trimesh.transform_points([[0.0, 0.0, 0.5 * length]], frame)[0]
    return Design(f"own{2 * radius * 10:.0f}x{length:.0f}", solid, solid, tip, center, frame[:3, 0], length, end)


def lassoan_design(rng: np.random.Generator, folder: Path) -> Design:
    """A screw of the PedicleScrewSimulator, along y, with a tower over its tulip."""
    known = json.loads((folder / "models.json").read_text())["models"]
    file = str(rng.choice(sorted(known)))
    raw, facts = trimesh.load_mesh(folder / file), known[file]
    tip, top = np.array(facts["tip"]), facts["head_top"][1]
    tower = tube(rng, top - rng.uniform(4.0, 8.0), top + rng.uniform(45.0, 90.0), 6.7, rng.uniform(7.7, 8.4))
    to_y = np.array([[0, 1, 0, tip[0]], [0, 0, 1, 0], [1, 0, 0, tip[2]], [0, 0, 0, 1.0]])  # z, x to y, z
    tower.apply_transform(to_y)
    solid = trimesh.boolean.union([closed(raw), tower], engine="manifold")
    is_raw = rng.random() < 0.5
    mesh = trimesh.util.concatenate([raw, tower]) if is_raw else solid
    name = file[len("scaled_") : -len(".stl")] + "-raw" * is_raw
    reach, rod = float(tower.bounds[1, 1] - tip[1]), np.array([0.0, 0.0, 1.0])
    length = float(facts["head_base"][1] - tip[1])
    return Design(name, solid, mesh, tip, np.array(facts["shank_center"]), rod, length, reach)


def posed(design: Design, tip: FloatArray, axis: FloatArray, rod: FloatArray) -> FloatArray:
    """world_from_cad with the tip here, the axis along `axis` and the rod's direction nearest to `rod`."""

    def frame(z: FloatArray, x: FloatArray) -> FloatArray:
        z = z / np.linalg.norm(z)
        x = x - (x @ z) * z
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z])

    turn = frame(axis, rod) @ frame(design.center - design.tip, design.rod).T
    return np.vstack([np.column_stack([turn, tip - turn @ design.tip]), [0.0, 0.0, 0.0, 1.0]])


def landmarks(screw: tuple[Design, FloatArray]) -> FloatArray:
    """(2, 3): tip and centre in the world, mm."""
    return np.asarray(trimesh.transform_points([screw[0].tip, screw[0].center], screw[1]))


def is_apart(screws: list[tuple[FloatArray, FloatArray, float]]) -> bool:
    """Whether the last of (tip, axis, reach) stays clear of the others."""
    lines = [tip + np.linspace(0.0, reach, 40)[:, None] * axis for tip, axis, reach in screws]
    return all(np.linalg.norm(lines[-1][:, None] - line, axis=-1).min() > _APART_MM for line in lines[:-1])


def ct_scene(rng: np.random.Generator, designs: list[Design], affine: FloatArray) -> list[tuple[Design, FloatArray]]:
    """2 to 8 screws in pedicles."""
    count = int(rng.integers(2, 9))
    first, levels = 0, (count + 1) // 2 + int(rng.random() < 0.4 and count < 6)
    first = int(rng.integers(0, len(_LEVELS_K) - levels + 1))
    places = [(k, side) for k in _LEVELS_K[first : first + levels] for side in (-1, 1)]
    screws: list[tuple[Design, FloatArray]] = []
    lines: list[tuple[FloatArray, FloatArray, float]] = []
    for k, side in [places[i] for i in sorted(rng.permutation(len(places))[:count])]:
        design = designs[int(rng.integers(len(designs)))]
        for _ in range(100):
            middle = trimesh.transform_points([[_SPINE_I, _BODY_J, k]], affine)[0]
            entry = middle + [side * rng.normal(20.0, 2.0), -45.0, rng.normal(3.0, 3.0)]
            axis = entry - middle - np.array([side * rng.normal(6.0, 2.0), 0.0, rng.normal(0.0, 3.0)])
            axis /= np.linalg.norm(axis)
            tip = entry - design.length_mm * axis
            if is_apart([*lines, (tip, axis, design.reach_mm)]):
                lines.append((tip, axis, design.reach_mm))
                rod = np.array([rng.normal(0, 0.25), 0.0, rng.choice([-1.0, 1.0])])
                screws.append((design, posed(design, tip, axis, rod)))
                break
    return screws


def ct_views(rng: np.random.Generator, middle: FloatArray) -> list[View]:
    """Two C-arm views of a point, 55 to 100 degrees apart about the body's axis."""
    side, apart = rng.choice([-1.0, 1.0]), rng.uniform(55.0, 100.0)
    begin = rng.normal(0.0, 8.0) + rng.choice([0.0, 180.0])
    sizes = (int(rng.integers(800, 1501)), int(rng.integers(800, 1501)))
    size = sizes if rng.random() < 0.5 else (sizes[0], sizes[0])
    views = []
    for name, angle in (("AP", begin), ("LAT", begin + side * apart)):
        turn = Rotation.from_euler("ZX", [angle, rng.normal(0.0, 6.0)], degrees=True)
        ray, down = turn.apply([0.0, 1.0, 0.0]), turn.apply([0.0, 0.0, -1.0])
        image = Rotation.from_rotvec(np.radians(rng.choice([0, 0, 90, 180]) + rng.normal(0.0, 4.0)) * ray)
        down = image.apply(down)
        source = middle - rng.uniform(620.0, 760.0) * ray + image.apply(np.cross(down, ray)) * rng.normal(0.0, 8.0)
        focal = rng.uniform(980.0, 1180.0) * max(size) / rng.uniform(290.0, 400.0)
        point = 0.5 * (np.array(size) - 1.0) + rng.normal(0.0, 12.0, 2)
        axes = np.stack([np.cross(down, ray), down, ray])
        internal = np.array([[focal, 0, point[0]], [0, focal, point[1]], [0, 0, 1.0]])
        views.append(View(name, internal @ np.column_stack([axes, -axes @ source]), size))
    return views


def ct_image(rng: np.random.Generator, view: View, solids: list[trimesh.Trimesh], scan: Any, look: Any) -> Any:
    """A DRR through CT and metal: exposure, scatter, blur, noise, display."""
    hounsfield, index_from_world = scan
    width, height = view.size
    u, v = (np.arange(-_CT_STRIDE, n + 2 * _CT_STRIDE, _CT_STRIDE) for n in view.size)
    rays = directions(view, u[None].astype(float), v[:, None].astype(float))
    source = -np.linalg.solve(view.projection[:, :3], view.projection[:, 3])
    water, bone = np.zeros(rays.shape[:2]), np.zeros(rays.shape[:2])
    for w in np.arange(300.0, 1150.0, _CT_STEP_MM):
        at = trimesh.transform_points((source + w * rays).reshape(-1, 3), index_from_world)
        if (at.min(axis=0) > hounsfield.shape).any() or (at.max(axis=0) < 0).any():
            continue
        values = ndimage.map_coordinates(hounsfield, at.T, order=1, cval=-1000.0).reshape(water.shape)
        water += np.clip(values / 1000.0 + 1.0, 0.0, 1.0) * _CT_STEP_MM
        bone += np.clip(values / 1000.0, 0.0, 2.0) * _CT_STEP_MM
    at, metal = np.mgrid[:height, :width] / _CT_STRIDE + 1.0, path_lengths(view, solids)
    water, bone = (ndimage.map_coordinates(a * np.linalg.norm(rays, axis=-1), at) for a in (water, bone))
    lost = ndimage.gaussian_filter(rng.normal(size=(height, width)), rng.uniform(1.5, 4.0))
    lost *= _SKEWED / lost.std() * np.clip(water / 200.0, 0.0, 1.0)
    signal = sum(
        share * np.exp(lost - a * water - b * bone) * through_metal(metal, c - a)
        for share, a, b, c in zip(_SHARES, _WATER, _BONE, _TITANIUM, strict=True)
    )
    signal /= np.median(signal[height // 3 : -height // 3, width // 3 : -width // 3])
    signal += look["scatter"] * ndimage.gaussian_filter(np.minimum(signal, 8.0), 0.06 * width)
    counts = ndimage.gaussian_filter(signal, look["blur_px"]) * look["photons"]
    counts = ndimage.gaussian_filter(rng.poisson(counts).astype(float), 0.4)
    is_log, most = look["curve"] == "log", 12 * look["photons"]
    grey = np.log(np.maximum(counts, 1.0)) if is_log else np.minimum(counts, most) ** 0.4
    low, high = np.percentile(grey, [0.05, 99.0])
    grey = np.clip((grey - low) / (high - low) * 0.96 + 0.03, 0.0, 1.0)
    return np.round((1.0 - grey if look["is_bright"] else grey) * (2 ** look["bits"] - 1))


def real_scene(rng: np.random.Generator, designs: list[Design], pair: Any, images: Any, views: list[View]) -> Any:
    """2 to 5 screws about the knee implant, like a row of pedicle screws, landmarks inside both round fields."""
    fields = [ndimage.binary_erosion(image > 8, iterations=25) for image in images]
    femur = np.array(pair["femur_world_from_cad"])
    rays = np.stack([np.linalg.inv(view.projection[:, :3])[:, 2] for view in views])
    along = np.cross(rays[0], rays[1])  # no view looks along it: the row of the screws
    while True:
        count, screws, lines = int(rng.integers(2, 6)), [], []
        common = Rotation.random(random_state=rng).apply([0.0, 0.0, 1.0])
        common = common - 0.9 * (common @ along) / (along @ along) * along
        common /= np.linalg.norm(common)
        if np.abs(rays @ common / np.linalg.norm(rays, axis=1)).max() > np.cos(np.radians(25.0)):
            continue
        for _ in range(400):
            design = designs[int(rng.integers(len(designs)))]
            axis = common + rng.normal(0.0, 0.15, 3)
            axis /= np.linalg.norm(axis)
            tip = femur[:3, 3] + rng.normal(0.0, 28.0, 3) - 0.35 * design.reach_mm * axis
            ends = tip + np.outer([0.0, design.length_mm, 0.8 * design.reach_mm], axis)
            uv = [np.round(projected(view, ends)[:, :2]).astype(int) for view in views]
            is_seen = all((p > 0).all() and (p < 1023).all() for p in uv)
            is_seen = is_seen and all(f[p[:, 1], p[:, 0]].all() for p, f in zip(uv, fields, strict=True))
            if is_seen and is_apart([*lines, (tip, axis, design.reach_mm)]):
                lines.append((tip, axis, design.reach_mm))
                screws.append((design, posed(design, tip, axis, along * rng.choice([-1, 1]) + rng.normal(0, 0.2, 3))))
            if len(screws) == count:
                return screws


def real_image(rng: np.random.Generator, view: View, solids: list[trimesh.Trimesh], image: Any, look: Any) -> Any:
    """Screws multiplied into an X-ray above its veil, the noise made up to what the image has at the new grey."""
    grey, metal = image.astype(float), path_lengths(view, solids)
    through = 0.5 * (through_metal(metal, look["per_mm"]) + through_metal(metal, 0.4 * look["per_mm"]))
    through = ndimage.gaussian_filter(through, look["blur_px"])
    veil = np.minimum(look["veil"], grey)
    made = veil + (grey - veil) * through
    rough = np.abs(grey[:, 1:-1] - 0.5 * (grey[:, 2:] + grey[:, :-2])) / np.sqrt(1.5)
    rough += np.random.default_rng(0).random(rough.shape) * 0.3  # the 8 bits' steps
    level, levels = ndimage.gaussian_filter(grey, 2.0)[:, 1:-1], np.arange(30.0, 236.0, 15.0)
    noises = [1.48 * np.median(rough[np.abs(level - middle) < 8.0]) for middle in levels]
    wanted, left = np.interp(made, levels, noises), np.interp(grey, levels, noises) * through
    more = np.sqrt(np.maximum(0.0, wanted**2 - left**2)) * (through < 0.98)
    return np.round(np.clip(made + rng.normal(size=grey.shape) * more, 0, 255))


def write_case(rng: np.random.Generator, folder: Path, views: list[View], images: Any, screws: Any, given: Any) -> None:
    """Everything that the format asks for, marks made and labels drawn here."""
    (folder / "models").mkdir(parents=True)
    designs = {design.name: design for design, _ in screws}
    for name, design in designs.items():
        design.mesh.export(folder / "models" / f"{name}.stl")
    for view, (pixels, bits, _) in zip(views, images, strict=True):
        (folder / f"{view.name}.png").write_bytes(encode_png(pixels.astype(f"uint{bits}")))
    names_model = len(designs) == 1 or rng.random() < 0.5
    is_hiding = len(screws) > 2 and rng.random() < 1 / 3
    hidden = (int(rng.integers(len(screws))), int(rng.integers(2))) if is_hiding else None
    labels: list[dict[str, str]] = [{} for _ in screws]
    marks: dict[str, list[Any]] = {view.name: [] for view in views}
    for number, view in enumerate(views):
        seen = [index for index in range(len(screws)) if (index, number) != hidden]
        for place, index in enumerate(rng.permutation(seen)):
            tip, center = projected(view, landmarks(screws[index]))[:, :2] + rng.normal(0.0, given.landmark_sd, (2, 2))
            label = labels[index][view.name] = "12345678"[place] if number == 0 else "abcdefgh"[place]
            mark = {"label": label, "tip": tip.tolist(), "center": center.tolist()}
            marks[view.name].append(mark | ({"model": screws[index][0].name} if names_model else {}))
    case = {
        "format": "screwpose-case/1",
        "id": f"unseen-{given.kind}-{given.seed}-{folder.name}",
        "views": {
            view.name: {"image": f"{view.name}.png", "projection": view.projection.tolist(), "polarity": image[2]}
            for view, image in zip(views, images, strict=True)
        },
        "models": {
            name: {"mesh": f"models/{name}.stl", "tip": design.tip.tolist(), "center": design.center.tolist()}
            for name, design in designs.items()
        },
        "annotations": marks,
    }
    truth = [
        {"labels": of, "model": design.name, "world_from_cad": pose.tolist()}
        for of, (design, pose) in zip(labels, screws, strict=True)
    ]
    write_json(folder / "case.json", case)
    write_json(folder / "truth.json", {"format": "screwpose-truth/1", "case": case["id"], "screws": truth})


def make_case(rng: np.random.Generator, index: int, data: Path, scan: Any, given: Any) -> None:
    """One folder."""
    designs = [
        own_design(rng) if rng.random() < 0.6 else lassoan_design(rng, data / "screws_lassoan")
        for _ in range(int(rng.integers(1, 3)))
    ]
    greys: list[Any] = [None, None]
    look: dict[str, Any] = {"blur_px": rng.uniform(0.6, 1.2)}
    if given.kind == "ct":
        while True:
            screws = ct_scene(rng, designs, scan[2])
            middle = np.mean([[-1.0, 2.0] @ landmarks(screw) for screw in screws], axis=0)  # of the heads
            views = ct_views(rng, middle + rng.normal(0.0, 8.0, 3))
            uv = [projected(view, np.vstack([landmarks(screw) for screw in screws]))[:, :2] for view in views]
            is_in = [(p > 10).all() and (p < np.array(view.size) - 11).all() for p, view in zip(uv, views, strict=True)]
            if all(is_in) and len(screws) > 1:
                break
        look |= {"scatter": rng.uniform(0.1, 0.8), "photons": 10 ** rng.uniform(2.5, 3.7)}
        look |= {"bits": int(rng.choice([8, 16])), "curve": str(rng.choice(["log", "power"]))}
        look |= {"is_bright": bool(rng.random() < 0.3)}
    else:
        pair = json.loads((data / "jtml_biplane" / "cases.json").read_text())["cases"][index % 16]
        views = [View(name, np.array(v["projection"]), (1024, 1024)) for name, v in pair["views"].items()]
        greys = [np.array(Image.open(data / "jtml_biplane" / v["image"])) for v in pair["views"].values()]
        screws = real_scene(rng, designs, pair, greys, views)
        look |= {"per_mm": rng.uniform(0.15, 0.4), "veil": rng.uniform(0.0, 35.0), "bits": 8, "is_bright": False}
    solids = [design.solid.copy().apply_transform(pose) for design, pose in screws]
    metal = "metal-bright" if look["is_bright"] else "metal-dark"
    images = []
    for view, grey in zip(views, greys, strict=True):
        pixels = (
            real_image(rng, view, solids, grey, look)
            if greys[0] is not None
            else ct_image(rng, view, solids, scan[:2], look)
        )
        images.append((pixels, look["bits"], metal if rng.random() < 0.5 else "auto"))
    write_case(rng, given.out / f"{index:03d}", views, images, screws, given)
    write_json(given.out / f"{index:03d}" / "unseen.json", {"look": look, "screws": [d.name for d, _ in screws]})


def main() -> None:
    """Make the cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the case folders")
    parser.add_argument("--kind", choices=("ct", "real"), required=True, help="what the background is")
    parser.add_argument("--count", type=int, default=20, help="how many cases")
    parser.add_argument("--seed", type=int, default=7001)
    parser.add_argument("--landmark-sd", type=float, default=2.0, help="of the marks, px")
    given = parser.parse_args()
    data = Path(os.environ.get("SCREWPOSE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    scan: Any = nibabel.load(data / "ct" / "example_ct.nii.gz")
    affine = scan.affine @ np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -30], [0, 0, 0, 1.0]])
    # The body goes on above and below, as its last slices are.
    hounsfield = np.pad(scan.get_fdata(dtype=np.float32), ((0, 0), (0, 0), (30, 30)), mode="edge")
    for index in track(range(given.count), console=Console(stderr=True)):
        rng = np.random.default_rng([given.seed, index, given.kind == "ct"])
        make_case(rng, index, data, (hounsfield, np.linalg.inv(affine), scan.affine), given)


if __name__ == "__main__":
    main()
