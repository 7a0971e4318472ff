"""One scene, and everything that can draw and score it: what `engines.py` times side by side.

Each rival is a function of a scene's number; its mask is checked against ours before anything is timed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants import Implant, Mesh, ScrewDesign, make_screw
from screwpose.implants.mesh import reduced
from screwpose.projection import opencv, reference
from screwpose.projection.contour import closed_surface
from screwpose.projection.silhouette import packed
from screwpose.projection.thickness import path_lengths
from screwpose.registration.search import SearchOptions, bounds_rad_mm, moved_by_each
from screwpose.similarity import Posed, SceneEngine, Target, dice, make_target, union_mask

FIELD_MM, SOURCE_MM, DETECTOR_MM = 307.2, 700.0, 1000.0  # 1024 pixels of 0.3 mm; a C-arm's distances
FULL = ScrewDesign()


@dataclass(frozen=True, eq=False)
class Scene:
    """Screws before a C-arm, at candidates of a search: the truth displaced within the bounds of `SearchOptions`.

    Parameters
    ----------
    meshes : one a screw.
    poses : (K, B, 4, 4), world_from_cad; the camera's frame is the world's.
    """

    camera: Camera
    intrinsics: FloatArray
    target: Target
    meshes: tuple[Mesh, ...]
    poses: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.target.shape

    def engine(self, threads: int = 1) -> SceneEngine:
        """Our engine, for this scene."""
        return SceneEngine({"AP": self.camera}, {"AP": self.target}, self.meshes, threads)

    def posed(self, k: int) -> list[Posed]:
        """The screws of candidate k."""
        return [Posed(mesh, pose) for mesh, pose in zip(self.meshes, self.poses[k], strict=True)]


@cache
def screw(faces: int | None) -> Implant:
    """The library's screw with so many faces: made of more segments, then split in four, then decimated.

    None: as it is made.
    """
    implant = make_screw(FULL)
    if faces is None:
        return implant
    if len(implant.mesh.faces) < faces:
        implant = make_screw(ScrewDesign(segments=256))
    mesh = implant.mesh
    while len(mesh.faces) < faces:
        mesh = split_in_four(mesh)
    mesh = reduced(mesh, faces)
    assert closed_surface(mesh.vertices_mm, mesh.faces) is not None, f"{len(mesh.faces)} faces are not closed"
    return Implant(implant.name, mesh, implant.tip_mm, implant.center_mm)


def split_in_four(mesh: Mesh) -> Mesh:
    """Every face as four, by the middles of its edges."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends, middle = np.unique(edges, axis=0, return_inverse=True)
    middle = middle.reshape(-1, 3) + len(mesh.vertices_mm)
    (a, b, c), (ab, bc, ca) = mesh.faces.T, middle.T
    faces = np.concatenate([np.stack(four, axis=1) for four in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return Mesh(np.concatenate([mesh.vertices_mm, mesh.vertices_mm[ends].mean(axis=1)]), faces)


def make_scene(faces: int | None, pixels: int = 1024, screws: int = 2, candidates: int = 40, seed: int = 7) -> Scene:
    """Screws in rows of four, 40 mm apart, converging as pedicle screws do; seen by `pixels` x `pixels`."""
    rng = np.random.default_rng(seed)
    implant = screw(faces)
    px = pixels / FIELD_MM * DETECTOR_MM
    intrinsics = np.array([[px, 0.0, 0.5 * (pixels - 1)], [0.0, px, 0.5 * (pixels - 1)], [0.0, 0.0, 1.0]])
    camera = Camera.from_matrix(np.column_stack([intrinsics, np.zeros(3)]))
    each = []
    options = SearchOptions()
    for index in range(screws):
        across = index % 4 - 0.5 * (min(screws, 4) - 1)
        truth = np.eye(4)
        truth[:3, :3] = rigid.exp_rotation(np.array([0.35, 0.0, -0.2 * across]) + rng.normal(scale=0.05, size=3))
        truth[:3, 3] = [40.0 * across, -75.0 + 25.0 * (index // 4), SOURCE_MM]
        limits = bounds_rad_mm(options)
        changes = rng.uniform(-limits, limits, (candidates, 6))
        each.append(moved_by_each(implant, truth, changes))
    poses = np.stack(each, axis=1)
    meshes = (implant.mesh,) * screws
    covered = union_mask(camera, [Posed(implant.mesh, one[0]) for one in each], (pixels, pixels), opencv.silhouette)
    pixels_shown = (covered + rng.normal(scale=0.1, size=covered.shape)).astype(np.float32)
    target = make_target(pixels_shown, np.ones_like(covered), covered)
    return Scene(camera, intrinsics, target, meshes, poses)


def scored(scene: Scene, mask: BoolArray) -> tuple[float, float]:
    """Loss and Dice of a painted mask, as the paper's method computes them."""
    return scene.target.loss(mask), dice(mask, scene.target.metal)


def opencv_triangles(scene: Scene) -> Callable[[int], BoolArray]:
    """One cv2.fillConvexPoly a triangle: the paper's way."""
    return lambda k: union_mask(scene.camera, scene.posed(k), scene.shape, opencv.silhouette)


def opencv_one_call(scene: Scene) -> Callable[[int], BoolArray]:
    """One cv2.fillPoly for all triangles. It fills by even and odd, so that triangles one behind the other cancel."""
    import cv2

    def draw(k: int) -> BoolArray:
        canvas = np.zeros(scene.shape, dtype=np.uint8)
        for posed in scene.posed(k):
            pixels = scene.camera.project(rigid.transform(posed.world_from_cad, posed.mesh.vertices_mm))
            fixed = np.rint(pixels * 256.0).astype(np.int32)
            cv2.fillPoly(canvas, list(fixed[posed.mesh.faces]), 1, cv2.LINE_8, 8)
        return canvas.view(np.bool_)

    return draw


def bit_rows_by_face(scene: Scene) -> Callable[[int], BoolArray]:
    """Our bit rows, face by face: what open meshes get."""
    from screwpose.projection.silhouette import silhouette

    return lambda k: union_mask(scene.camera, scene.posed(k), scene.shape, silhouette)


class EmbreeRays:
    """One ray a pixel of each screw's own box, by trimesh and Embree; the trees are built once, the rays are moved."""

    def __init__(self, scene: Scene) -> None:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self._scene = scene
        made = {
            id(mesh): RayMeshIntersector(trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False))
            for mesh in scene.meshes
        }
        self._trees = [made[id(mesh)] for mesh in scene.meshes]

    def rays(self, k: int, body: int) -> tuple[tuple[slice, slice], FloatArray, FloatArray]:
        """The window of a screw, the source and the directions of its rays, in the CAD's frame."""
        scene = self._scene
        window = window_of(scene, k, body)
        v, u = np.mgrid[window]
        cad_from_world = rigid.invert(scene.poses[k, body])
        pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
        directions = pixels @ np.linalg.inv(scene.intrinsics).T @ cad_from_world[:3, :3].T
        return window, cad_from_world[:3, 3], directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def mask(self, k: int) -> BoolArray:
        """The pixels whose rays hit a screw."""
        mask = np.zeros(self._scene.shape, dtype=np.bool_)
        for body, tree in enumerate(self._trees):
            window, source, directions = self.rays(k, body)
            hit = tree.intersects_any(np.broadcast_to(source, directions.shape), directions)
            mask[window] |= hit.reshape(mask[window].shape)
        return mask

    def lengths(self, k: int, body: int = 0) -> FloatArray:
        """The path lengths, mm, in the screw's window: every second distance less the one before."""
        window, source, directions = self.rays(k, body)
        hits, ray, _ = self._trees[body].intersects_location(
            np.broadcast_to(source, directions.shape), directions, multiple_hits=True
        )
        distance = np.linalg.norm(hits - source, axis=1)
        order = np.lexsort((distance, ray))
        ray, distance = ray[order], distance[order]
        first = np.concatenate([[0], np.flatnonzero(np.diff(ray)) + 1]) if len(ray) else np.zeros(0, dtype=int)
        place = np.arange(len(ray)) - np.repeat(first, np.diff(np.append(first, len(ray))))
        lengths = np.bincount(ray, weights=np.where(place % 2 == 1, distance, -distance), minlength=len(directions))
        shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
        return np.asarray(lengths.reshape(shape), dtype=np.float64)


def window_of(scene: Scene, k: int, body: int) -> tuple[slice, slice]:
    """The part of the image that a screw's vertices reach."""
    pixels = scene.camera.project(rigid.transform(scene.poses[k, body], scene.meshes[body].vertices_mm))
    low = np.clip(np.floor(pixels.min(axis=0)), 0, scene.shape[::-1]).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, scene.shape[::-1]).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def our_lengths(scene: Scene, k: int, body: int = 0) -> FloatArray:
    """Path lengths by `projection.thickness`, mm, in the same window."""
    mesh = scene.meshes[body]
    window = window_of(scene, k, body)
    return path_lengths(scene.intrinsics, scene.poses[k, body], mesh.vertices_mm, mesh.faces, window).lengths_mm


class VtkRender:
    """VTK off-screen: white screws without light on black, read back."""

    def __init__(self, scene: Scene) -> None:
        import vtk
        from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

        vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)
        self._scene, self._vtk = scene, vtk
        rows, columns = scene.shape
        self._window = vtk.vtkRenderWindow()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._window.SetSize(columns, rows)
        renderer = vtk.vtkRenderer()
        self._window.AddRenderer(renderer)
        self._actors = []
        for mesh in scene.meshes:
            points, cells, data = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
            points.SetData(numpy_to_vtk(mesh.vertices_mm, deep=True))
            cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(mesh.faces).ravel(), deep=True))
            data.SetPoints(points)
            data.SetPolys(cells)
            mapper, actor = vtk.vtkPolyDataMapper(), vtk.vtkActor()
            mapper.SetInputData(data)
            actor.SetMapper(mapper)
            actor.GetProperty().LightingOff()
            renderer.AddActor(actor)
            self._actors.append(actor)
        # VTK looks along -z with v upwards; a pixel's centre is half a pixel off its edge.
        K, near, far = scene.intrinsics, 100.0, 2000.0
        clip = np.zeros((4, 4))
        clip[0, 0], clip[0, 2] = 2.0 * K[0, 0] / columns, 1.0 - 2.0 * (K[0, 2] + 0.5) / columns
        clip[1, 1], clip[1, 2] = 2.0 * K[1, 1] / rows, 2.0 * (K[1, 2] + 0.5) / rows - 1.0
        clip[2, 2], clip[2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
        clip[3, 2] = -1.0
        camera = renderer.GetActiveCamera()
        camera.SetPosition(0.0, 0.0, 0.0)
        camera.SetFocalPoint(0.0, 0.0, 1.0)
        camera.SetViewUp(0.0, -1.0, 0.0)
        camera.SetClippingRange(near, far)
        camera.UseExplicitProjectionTransformMatrixOn()
        camera.SetExplicitProjectionTransformMatrix(self._matrix(clip))
        self._read = vtk.vtkUnsignedCharArray()

    def _matrix(self, values: FloatArray) -> object:
        matrix = self._vtk.vtkMatrix4x4()
        matrix.DeepCopy(values.ravel().tolist())
        return matrix

    def mask(self, k: int) -> BoolArray:
        """What is not black."""
        from vtk.util.numpy_support import vtk_to_numpy

        for actor, pose in zip(self._actors, self._scene.poses[k], strict=True):
            actor.SetUserMatrix(self._matrix(pose))
        self._window.Render()
        rows, columns = self._scene.shape
        self._window.GetPixelData(0, 0, columns - 1, rows - 1, 0, self._read, 0)
        return np.asarray(vtk_to_numpy(self._read).reshape(rows, columns, 3)[::-1, :, 0] > 127)


class LowerBound:
    """What no engine on bits can do without: every vertex projected once, every run of the final mask written.

    The runs are given, of the first candidate. Nothing is cleared, sorted, decided or counted.
    """

    def __init__(self, scene: Scene) -> None:
        from engine_bound import write_bits

        self._kernel, self._scene = write_bits, scene
        mask = np.zeros((scene.shape[0], scene.shape[1] + 2), dtype=np.int8)
        mask[:, 1:-1] = scene.engine().mask(scene.poses[0], "AP")
        change = np.diff(mask, axis=1)
        rows, left = np.nonzero(change == 1)
        right = np.nonzero(change == -1)[1] - 1
        self._runs = np.stack([rows, left, right], axis=1).astype(np.int64)
        self._vertices = np.concatenate([mesh.vertices_mm for mesh in scene.meshes])
        self._starts = np.concatenate([[0], np.cumsum([len(mesh.vertices_mm) for mesh in scene.meshes])])
        self._bits = np.zeros_like(packed(np.zeros(scene.shape, dtype=np.bool_)))
        self._u, self._v = np.empty(len(self._vertices)), np.empty(len(self._vertices))

    def __call__(self) -> None:
        """All candidates."""
        scene = self._scene
        self._kernel(
            scene.camera.projection, scene.poses, self._vertices, self._starts, self._u, self._v, self._runs, self._bits
        )


def agreement(scene: Scene, draw: Callable[[int], BoolArray]) -> float:
    """The Dice coefficient of a rival's mask with ours, of the first candidate."""
    return dice(draw(0), scene.engine().mask(scene.poses[0], "AP"))


def differs_from_reference(scene: Scene) -> int:
    """How many pixels our mask of the first candidate and the reference's do not share."""
    want = union_mask(scene.camera, scene.posed(0), scene.shape, reference.silhouette)
    return int((want != scene.engine().mask(scene.poses[0], "AP")).sum())
