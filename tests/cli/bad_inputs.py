"""What people get wrong in a case: each mistake is a function that makes it in a good case's folder."""

from collections.abc import Callable

import imagecodecs
import numpy as np
import pydicom
from pydicom.dataset import FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, XRayAngiographicImageStorage, generate_uid

from screwpose.implants.model import Mesh
from tests.cli.case_folder import MODEL, CaseFolder

Mistake = Callable[[CaseFolder], None]
INCH, METRE = 25.4, 1000.0


def missing_case(c: CaseFolder) -> None:
    (c.folder / "case.json").unlink()


def case_is_a_list(c: CaseFolder) -> None:
    (c.folder / "case.json").write_text("[]")


def case_is_a_folder(c: CaseFolder) -> None:
    (c.folder / "case.json").unlink()
    (c.folder / "case.json").mkdir()


def case_is_cut(c: CaseFolder) -> None:
    text = (c.folder / "case.json").read_text()
    (c.folder / "case.json").write_text(text[: len(text) // 2])


# ---- images


def missing_image(c: CaseFolder) -> None:
    c.view("AP")["image"] = "app.png"


def unreadable_image(c: CaseFolder) -> None:
    path = c.folder / "ap.png"
    path.write_bytes(path.read_bytes()[:2000])


def image_of_text(c: CaseFolder) -> None:
    (c.folder / "ap.png").write_text("not an image\n")


def image_at_half_size(c: CaseFolder) -> None:
    c.set_pixels(c.pixels()[::2, ::2])
    for mark in c.marks("AP"):
        for key in ("tip", "center"):
            mark[key] = [x / 2 for x in mark[key]]


def image_at_half_size_marks_at_full(c: CaseFolder) -> None:
    c.set_pixels(c.pixels()[::2, ::2])


def black_image(c: CaseFolder) -> None:
    c.set_pixels(np.zeros_like(c.pixels()))


def equal_channels(c: CaseFolder) -> None:
    c.set_pixels(np.repeat(c.pixels()[..., None], 3, axis=2))


def coloured_image(c: CaseFolder) -> None:
    pixels = np.repeat(c.pixels()[..., None], 3, axis=2)
    pixels[5:9, 7:60] = (255, 0, 0)
    c.set_pixels(pixels)


def one_pixel_image(c: CaseFolder) -> None:
    c.set_pixels(np.array([[7]], np.uint8))


def tiny_image(c: CaseFolder) -> None:
    c.set_pixels(np.array([[7, 9], [20, 200]], np.uint8))


def long_thin_image(c: CaseFolder) -> None:
    c.set_pixels(np.tile(np.arange(20000, dtype=np.uint8), (1, 1)))


def image_twice(c: CaseFolder) -> None:
    c.view("LAT")["image"] = "ap.png"


def image_link_out(c: CaseFolder) -> None:
    outside = (c.folder.parent / "outside.png").resolve()
    (c.folder / "ap.png").rename(outside)
    (c.folder / "ap.png").symlink_to(outside)


def path_leaves(c: CaseFolder) -> None:
    c.view("AP")["image"] = "../secret.png"


def mask_of_other_size(c: CaseFolder) -> None:
    (c.folder / "mask.png").write_bytes(imagecodecs.png_encode(np.full((100, 120), 255, np.uint8)))
    c.view("AP")["mask"] = "mask.png"


def black_mask(c: CaseFolder) -> None:
    (c.folder / "mask.png").write_bytes(imagecodecs.png_encode(np.zeros_like(c.pixels())))
    c.view("AP")["mask"] = "mask.png"


def dicom(c: CaseFolder, *, with_pixels: bool, inverted: bool = False) -> None:
    stored = c.pixels().astype(np.uint16) * 16
    dataset = pydicom.Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = XRayAngiographicImageStorage
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID = generate_uid()
    dataset.Modality = "XA"
    if with_pixels:
        dataset.Rows, dataset.Columns = stored.shape
        dataset.SamplesPerPixel, dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 1, 16, 12, 11
        dataset.PixelRepresentation = 0
        dataset.PhotometricInterpretation = "MONOCHROME1" if inverted else "MONOCHROME2"
        dataset.PixelData = (4095 - stored if inverted else stored).tobytes()
    dataset.save_as(c.folder / "ap.dcm", enforce_file_format=True)
    c.view("AP")["image"] = "ap.dcm"


def dicom_without_pixels(c: CaseFolder) -> None:
    dicom(c, with_pixels=False)


def dicom_inverted(c: CaseFolder) -> None:
    dicom(c, with_pixels=True, inverted=True)


# ---- matrices


def transposed(c: CaseFolder) -> None:
    c.view("AP")["projection"] = c.matrix("AP").T.tolist()


def transposed_and_cut_anew(c: CaseFolder) -> None:
    c.set_matrix("AP", c.matrix("AP").T.reshape(3, 4))


def _decomposed(P: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from screwpose.geometry import Camera

    camera = Camera.from_matrix(P)
    pose = camera.camera_from_world
    return camera.intrinsics, pose[:3, :3], pose[:3, 3]


def rotation_transposed(c: CaseFolder) -> None:
    K, R, t = _decomposed(c.matrix("AP"))
    c.set_matrix("AP", K @ np.column_stack([R.T, t]))


def both_rotations_transposed(c: CaseFolder) -> None:
    for view in ("AP", "LAT"):
        K, R, t = _decomposed(c.matrix(view))
        c.set_matrix(view, K @ np.column_stack([R.T, t]))


def poses_inverted(c: CaseFolder) -> None:
    """world_from_camera written where camera_from_world belongs."""
    for view in ("AP", "LAT"):
        K, R, t = _decomposed(c.matrix(view))
        c.set_matrix(view, K @ np.column_stack([R.T, -R.T @ t]))


def matrices_in_metres(c: CaseFolder) -> None:
    for view in ("AP", "LAT"):
        c.set_matrix(view, c.matrix(view) @ np.diag([METRE, METRE, METRE, 1.0]))


def one_matrix_in_metres(c: CaseFolder) -> None:
    c.set_matrix("AP", c.matrix("AP") @ np.diag([METRE, METRE, METRE, 1.0]))


def behind_the_source(c: CaseFolder) -> None:
    """The camera stands on the far side and looks away: same rays, negative depth."""
    K, R, t = _decomposed(c.matrix("AP"))
    turned = np.diag([-1.0, 1.0, -1.0]) @ R
    center = -R.T @ t
    c.set_matrix("AP", K @ np.column_stack([turned, -turned @ center]))


def sign_changed(c: CaseFolder) -> None:
    c.set_matrix("AP", -3.5 * c.matrix("AP"))


def singular_matrix(c: CaseFolder) -> None:
    P = c.matrix("AP")
    P[1] = P[0]
    c.set_matrix("AP", P)


def zero_matrix(c: CaseFolder) -> None:
    c.set_matrix("AP", np.zeros((3, 4)))


def huge_matrix(c: CaseFolder) -> None:
    c.set_matrix("AP", np.full((3, 4), 1e308))


def huge_entry(c: CaseFolder) -> None:
    P = c.matrix("AP")
    P[0, 3] = 1e308
    c.set_matrix("AP", P)


def huge_scale(c: CaseFolder) -> None:
    c.set_matrix("AP", c.matrix("AP") * 1e300)


def huge_landmark(c: CaseFolder) -> None:
    c.marks("AP")[0]["tip"] = [1e308, -1e308]


def huge_model_landmark(c: CaseFolder) -> None:
    c.model["center"] = [0, 1e308, 1e308]


def same_matrix_twice(c: CaseFolder) -> None:
    c.set_matrix("LAT", c.matrix("AP"))


def views_swapped(c: CaseFolder) -> None:
    first, second = c.matrix("AP"), c.matrix("LAT")
    c.set_matrix("AP", second)
    c.set_matrix("LAT", first)


def images_swapped(c: CaseFolder) -> None:
    c.view("AP")["image"], c.view("LAT")["image"] = c.view("LAT")["image"], c.view("AP")["image"]


def rows_and_columns_swapped(c: CaseFolder) -> None:
    for view in ("AP", "LAT"):
        for mark in c.marks(view):
            mark["tip"].reverse()
            mark["center"].reverse()


# ---- meshes and models


def mesh_in_inches(c: CaseFolder) -> None:
    """The mesh alone: its landmarks are in mm, as the case says."""
    c.change_mesh(lambda mesh: Mesh(mesh.vertices_mm / INCH, mesh.faces))


def mesh_in_metres(c: CaseFolder) -> None:
    c.change_mesh(lambda mesh: Mesh(mesh.vertices_mm / METRE, mesh.faces))


def model_in_inches(c: CaseFolder) -> None:
    """The mesh and its landmarks."""
    mesh_in_inches(c)
    c.model["center"] = [x / INCH for x in c.model["center"]]


def model_in_metres(c: CaseFolder) -> None:
    mesh_in_metres(c)
    c.model["center"] = [x / METRE for x in c.model["center"]]


def mesh_declared_in_inches(c: CaseFolder) -> None:
    """A mesh in mm."""
    c.model["unit"] = "inch"


def mesh_in_inches_rightly(c: CaseFolder) -> None:
    mesh_in_inches(c)
    c.model["unit"] = "inch"


def unknown_unit(c: CaseFolder) -> None:
    c.model["unit"] = "-mm"


def negative_unit(c: CaseFolder) -> None:
    c.model["unit"] = -1


def empty_mesh(c: CaseFolder) -> None:
    c.mesh_file.write_bytes(b"")


def mesh_without_faces(c: CaseFolder) -> None:
    c.mesh_file.write_bytes(b"nothing".ljust(80) + bytes(4))


def truncated_mesh(c: CaseFolder) -> None:
    data = c.mesh_file.read_bytes()
    c.mesh_file.write_bytes(data[: len(data) // 2])


def open_mesh(c: CaseFolder) -> None:
    c.change_mesh(lambda mesh: Mesh(mesh.vertices_mm, mesh.faces[: -len(mesh.faces) // 20]))


def inside_out_mesh(c: CaseFolder) -> None:
    c.change_mesh(lambda mesh: Mesh(mesh.vertices_mm, mesh.faces[:, ::-1]))


def mesh_with_nan(c: CaseFolder) -> None:
    data = bytearray(c.mesh_file.read_bytes())
    data[96:100] = np.array([np.nan], "<f4").tobytes()  # the first facet's first corner
    c.mesh_file.write_bytes(bytes(data))


def model_is_its_case(c: CaseFolder) -> None:
    c.model["mesh"] = "case.json"


def part_is_the_model(c: CaseFolder) -> None:
    c.model["parts"] = [{"name": MODEL, "mesh": c.model["mesh"]}]


def ends_of_model_swapped(c: CaseFolder) -> None:
    c.model["tip"], c.model["center"] = c.model["center"], c.model["tip"]


def zero_length_screw(c: CaseFolder) -> None:
    c.model["center"] = c.model["tip"]


def center_of_the_whole(c: CaseFolder) -> None:
    """The middle of screw and tower, not of the screw."""
    c.model["center"] = [0, 70, 0]


# ---- annotations


def nan_in_landmarks(c: CaseFolder) -> None:
    c.marks("AP")[0]["tip"][0] = float("nan")


def landmark_outside(c: CaseFolder) -> None:
    c.marks("AP")[0]["tip"] = [700.0, 100.0]


def ends_swapped_in_one_view(c: CaseFolder) -> None:
    for mark in c.marks("LAT"):
        mark["tip"], mark["center"] = mark["center"], mark["tip"]


def ends_of_one_mark_swapped(c: CaseFolder) -> None:
    mark = c.marks("LAT")[0]
    mark["tip"], mark["center"] = mark["center"], mark["tip"]


def ends_swapped_everywhere(c: CaseFolder) -> None:
    for view in ("AP", "LAT"):
        for mark in c.marks(view):
            mark["tip"], mark["center"] = mark["center"], mark["tip"]


def label_missing(c: CaseFolder) -> None:
    del c.marks("AP")[1]["label"]


def screw_missing_in_a_view(c: CaseFolder) -> None:
    del c.marks("LAT")[1]


def no_screws_in_a_view(c: CaseFolder) -> None:
    c.marks("LAT").clear()


def duplicate_labels(c: CaseFolder) -> None:
    c.marks("AP")[1]["label"] = c.marks("AP")[0]["label"]


def labels_of_one_screw_twice(c: CaseFolder) -> None:
    c.marks("AP")[1] = {**c.marks("AP")[0], "label": "2"}


def unknown_key(c: CaseFolder) -> None:
    c.view("AP")["polarty"] = "metal-dark"


def unknown_model(c: CaseFolder) -> None:
    c.marks("AP")[0]["model"] = "ms55x5"


def annotations_of_unknown_view(c: CaseFolder) -> None:
    c.data["annotations"]["lat"] = c.data["annotations"].pop("LAT")


def view_named_path(c: CaseFolder) -> None:
    for part in ("views", "annotations"):
        c.data[part]["../x"] = c.data[part].pop("AP")


def views_equal_but_for_case(c: CaseFolder) -> None:
    for part in ("views", "annotations"):
        c.data[part]["ap"] = c.data[part].pop("LAT")


def odd_labels(c: CaseFolder) -> None:
    for mark, label in zip(c.marks("AP"), ("<script>alert(1)</script>", "L4/left\n../..\\[red]"), strict=True):
        mark["label"] = label
    c.marks("LAT")[0]["label"] = "x" * 4000


def odd_model_name(c: CaseFolder) -> None:
    name = "../../[red]<b>ü & \n"
    c.data["models"][name] = c.data["models"].pop(MODEL)
    for view in ("AP", "LAT"):
        for mark in c.marks(view):
            mark["model"] = name


def odd_file_names(c: CaseFolder) -> None:
    for view, name in (("AP", "ap [red] ü 椎.png"), ("LAT", "lat #1 %20 'x'.png")):
        (c.folder / c.view(view)["image"]).rename(c.folder / name)
        c.view(view)["image"] = name


def strange_screws(c: CaseFolder) -> None:
    """Marks in both views that no screw can have made."""
    c.marks("AP").append({"label": "n", "tip": [60.0, 200.0], "center": [60.0, 170.0]})
    c.marks("LAT").append({"label": "n", "tip": [150.0, 60.0], "center": [170.0, 60.0]})


def three_more_screws(c: CaseFolder) -> None:
    """Three more in AP, the first of them in LAT too: the other two are hidden there."""
    for i, tip_mm in enumerate(([-20.0, 0.0, 25.0], [20.0, 2.0, 27.0], [18.0, 0.0, -25.0])):
        for view in ("AP", "LAT") if i == 0 else ("AP",):
            ends = np.array([tip_mm, np.add(tip_mm, [0.0, 25.0, 0.0])])
            w = np.column_stack([ends, np.ones(2)]) @ c.matrix(view).T
            tip, center = (w[:, :2] / w[:, 2:]).tolist()
            c.marks(view).append({"label": f"n{i}" if view == "AP" else "n", "tip": tip, "center": center})


def empty_id(c: CaseFolder) -> None:
    c.data["id"] = ""
