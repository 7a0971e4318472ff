"""The projection matrices of a case: their sign settled, and held against the images and each other."""

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import CalibrationError, GeometryError
from screwpose.files.inspection import Inspection
from screwpose.geometry import Camera, triangulate
from screwpose.geometry.triangulation import linear_system

Size = tuple[int, int]

# A C-arm (source to detector about 1 m, detector 0.2 to 0.4 m) has a focal length of 2 to 6 image widths. Twice or
# half as much may be a crop or a binned image; these bounds leave room for ten times.
_FOCAL_WIDTHS = (0.3, 60.0)
_MAX_ASPECT = 1.25  # f_u / f_v; the real biplane sets have 1.00 to 1.05
_MAX_SKEW = 0.05  # of the focal length; detectors have none
_MAX_OFF_CENTER = 1.0  # image sizes between the principal point and the image's middle; cropped images have some
_RATIO_AGREES = 0.03  # how well the principal point's two coordinates must agree on a wrong image size
_RATIO_MATTERS = 0.2


def cameras_of(
    matrices: Mapping[str, FloatArray],
    sizes: Mapping[str, Size],
    middles_px: Mapping[str, FloatArray],
    inspection: Inspection,
) -> dict[str, Camera]:
    """Make the cameras of all views; a matrix that cannot be one is left out, with an error noted.

    Parameters
    ----------
    matrices : (3, 4) of each view, of any scale and sign.
    sizes : (width, height) in px of each view whose image could be read.
    middles_px : (2,), px, of each view with annotations: their mean. Where the means' rays meet tells which side of
        the source is the front, where the matrix is of a kind that does not tell it.
    """
    cameras: dict[str, Camera] = {}
    for name, matrix in matrices.items():
        where = f"views.{name}.projection"
        camera = inspection.attempt(partial(Camera.from_matrix, matrix, sizes.get(name)), where)
        if camera is None:
            continue
        if _is_column_order(camera, matrix):
            inspection.error(
                where,
                "the numbers make no camera of this image as they stand, but one if they are read column by column",
                expected="3 rows of 4 numbers",
                remedy="The matrix looks transposed and cut anew: write it row by row.",
                kind=CalibrationError,
            )
            continue
        cameras[name] = camera
    point = _where_rays_meet(cameras, middles_px)
    if point is not None:
        cameras = {
            name: Camera.from_matrix(matrices[name], camera.image_size, point)
            if _is_left_handed(matrices[name])
            else camera
            for name, camera in cameras.items()
        }
    for name, camera in cameras.items():
        _check_against_image(camera, f"views.{name}.projection", inspection)
    _check_between(cameras, middles_px, inspection)
    return cameras


def _is_left_handed(matrix: FloatArray) -> bool:
    return bool(np.linalg.det(matrix[:, :3]) < 0)


def _where_rays_meet(cameras: Mapping[str, Camera], middles_px: Mapping[str, FloatArray]) -> FloatArray | None:
    """The middle of the annotations in the world, (3,), mm. The linear system does not care for the sign of P."""
    names = [name for name in cameras if name in middles_px]
    if len(names) < 2:
        return None
    A, b = linear_system([cameras[name] for name in names], np.array([middles_px[name] for name in names]))
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], dtype=np.float64)


def oddities(camera: Camera) -> Iterator[str]:
    """What is unusual in the intrinsics for the camera's image, which must have a size."""
    assert camera.image_size is not None
    size = np.array(camera.image_size, dtype=np.float64)
    K = camera.intrinsics
    focal, skew, principal_point = np.array([K[0, 0], K[1, 1]]), K[0, 1], K[:2, 2]
    widths = focal / size
    if widths.min() < _FOCAL_WIDTHS[0] or widths.max() > _FOCAL_WIDTHS[1]:
        yield f"the focal length is {focal[0]:.4g} x {focal[1]:.4g} px, {widths[0]:.3g} times the image's width"
    if max(focal) > _MAX_ASPECT * min(focal):
        yield f"the focal lengths along u and v are {focal[0]:.4g} and {focal[1]:.4g} px"
    if abs(skew) > _MAX_SKEW * focal[0]:
        yield f"the skew is {skew:.4g} px"
    off_center = np.abs(principal_point - (size - 1) / 2) / size
    if off_center.max() > _MAX_OFF_CENTER:
        yield (
            f"the principal point is [{principal_point[0]:.5g}, {principal_point[1]:.5g}], "
            f"{off_center.max():.3g} image sizes off the middle"
        )


def _is_column_order(camera: Camera, matrix: FloatArray) -> bool:
    """Whether the matrix is no camera of its image, but would be one if its twelve numbers were read by columns."""
    if camera.image_size is None or not any(oddities(camera)):
        return False
    try:
        other = Camera.from_matrix(matrix.reshape(4, 3).T, camera.image_size)
    except CalibrationError:
        return False
    return not any(oddities(other))


def _check_against_image(camera: Camera, where: str, inspection: Inspection) -> None:
    if not camera.is_right_handed:
        inspection.warn(
            where,
            "the matrix mirrors the image (seen from the source, u and v and the depth form a left-handed frame)",
            expected="u to the right and v down, unless the image is stored mirrored",
            remedy="If the image is not mirrored, one of the first two rows has the wrong sign, or they are swapped.",
            kind=CalibrationError,
        )
    if camera.image_size is None:
        return
    ratio = _size_ratio(camera)
    if ratio is not None:
        width, height = camera.image_size
        u, v = camera.intrinsics[:2, 2]
        inspection.warn(
            where,
            f"the principal point [{u:.5g}, {v:.5g}] is the middle of an image {ratio:.3g} times as large as "
            f"this one of {width} x {height} px",
            expected=f"about [{(width - 1) / 2:g}, {(height - 1) / 2:g}]",
            remedy=f"Was P calibrated for {ratio * width:.0f} x {ratio * height:.0f} px? Then multiply its first "
            f"two rows by {1 / ratio:.4g}, or give the image at that size.",
            kind=CalibrationError,
        )
        return
    for oddity in oddities(camera):
        inspection.warn(
            where,
            f"{oddity}, which is unusual for an image of {camera.image_size[0]} x {camera.image_size[1]} px",
            remedy="Does the matrix belong to this image, at this size?",
            kind=CalibrationError,
        )


def _size_ratio(camera: Camera) -> float | None:
    """How many times as large the image is of which the principal point is the middle, if that stands out."""
    assert camera.image_size is not None
    ratios = (camera.intrinsics[:2, 2] + 0.5) / (np.array(camera.image_size) / 2)
    ratio = float(ratios.mean())
    if ratio <= 0 or np.ptp(ratios) > _RATIO_AGREES * ratio or abs(ratio - 1) < _RATIO_MATTERS:
        return None
    return ratio


def _check_between(cameras: Mapping[str, Camera], middles_px: Mapping[str, FloatArray], inspection: Inspection) -> None:
    """Views must differ, their rays must meet, and do so in front of every source."""
    equal = False
    names = list(cameras)
    for index, name in enumerate(names):
        for other in names[:index]:
            if _are_equal(cameras[name], cameras[other]):
                equal = True
                inspection.error(
                    f"views.{name}.projection",
                    f"the matrix is the same as that of {other}",
                    expected="a view from another direction",
                    remedy="Was one calibration given to both views?",
                    kind=CalibrationError,
                )
    marked = [name for name in names if name in middles_px]
    if equal or len(marked) < 2:
        return
    point = _where_rays_meet(cameras, middles_px)
    behind = [name for name in marked if point is not None and cameras[name].depth_mm(point)[0] <= 0]
    for name in behind:
        depth_mm = float(cameras[name].depth_mm(np.asarray(point))[0])
        inspection.error(
            f"views.{name}.projection",
            f"negative depth: by the annotations the screws lie {-depth_mm:.4g} mm behind the X-ray source",
            expected="screws between source and detector",
            remedy="Are the matrices, images or annotations of two views swapped, or is a matrix of another frame?",
            kind=CalibrationError,
        )
    if not behind:
        try:
            triangulate([cameras[name] for name in marked], np.array([middles_px[name] for name in marked]))
        except GeometryError as error:
            inspection.error("views", str(error).rstrip("."), kind=CalibrationError)


def _are_equal(first: Camera, second: Camera) -> bool:
    # Rounding of the files apart; a real second view differs in the first digits.
    difference = np.linalg.norm(first.projection - second.projection, axis=1)
    return bool((difference <= 1e-6 * np.linalg.norm(first.projection, axis=1)).all())
