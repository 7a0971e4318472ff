"""A calibrated X-ray view: where a 3D point lands, and which ray a pixel sees.

A camera is its 3 x 4 projection matrix P and nothing more; intrinsics and pose are derived from it. P is kept
normalised so that the third homogeneous coordinate is the depth in mm: ``P [X Y Z 1]^T = w [u v 1]^T`` with the
third row's first three entries of length 1 and w > 0 in front of the source.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import rq

from screwpose._types import FloatArray
from screwpose.errors import BehindSourceError, CalibrationError

# A 3 x 3 block M = K R of a C-arm has a condition number near f / 1 px (some thousands); past this it is singular
# to the precision with which calibrations are written.
_MAX_CONDITION = 1e9


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated view.

    Parameters
    ----------
    projection : (3, 4), pixels from world mm. Any scale and sign of a matrix are accepted by `from_matrix`; the
        constructor itself wants it normalised.
    image_size : (width, height) in px, where known.
    """

    projection: FloatArray
    image_size: tuple[int, int] | None = None

    @classmethod
    def from_matrix(
        cls,
        projection: FloatArray,
        image_size: tuple[int, int] | None = None,
        in_front_in_world_mm: FloatArray | None = None,
    ) -> "Camera":
        """Normalise any 3 x 4 projection matrix.

        Parameters
        ----------
        projection : (3, 4), of any scale and sign.
        image_size : (width, height) in px.
        in_front_in_world_mm : (3,), a point known to be in front of the source. A matrix alone does not say which
            of P and -P is meant where its handedness is not the usual one (u right, v down, w away from the source);
            with the point that is settled. Without it, the sign that makes ``det(M) > 0`` is taken.

        Raises
        ------
        CalibrationError
            Not 3 x 4, not finite, or singular.

        References
        ----------
        Hartley & Zisserman (2004), section 6.2.3 (depth of points).
        """
        matrix = np.array(projection, dtype=np.float64)
        if matrix.shape != (3, 4):
            raise CalibrationError(f"a projection matrix of shape {matrix.shape}", expected="3 rows of 4 numbers")
        if not np.isfinite(matrix).all():
            raise CalibrationError("a projection matrix with entries that are not finite", expected="12 finite numbers")
        row_norm = np.linalg.norm(matrix[2, :3])
        if row_norm == 0 or np.linalg.cond(matrix[:, :3]) > _MAX_CONDITION:
            raise CalibrationError(
                "a singular projection matrix: its left 3 x 3 block has no inverse",
                expected="P = K [R | t] of a perspective camera",
            )
        matrix /= row_norm
        if in_front_in_world_mm is None:
            sign = np.sign(np.linalg.det(matrix[:, :3]))
        else:
            sign = np.sign(matrix[2] @ np.append(np.asarray(in_front_in_world_mm, dtype=np.float64), 1.0)) or 1.0
        return cls(matrix * sign, image_size)

    @cached_property
    def center_in_world_mm(self) -> FloatArray:
        """The X-ray source, (3,)."""
        return np.asarray(-np.linalg.solve(self.projection[:, :3], self.projection[:, 3]), dtype=np.float64)

    @cached_property
    def _k_r(self) -> tuple[FloatArray, FloatArray]:
        k, r = rq(self.projection[:, :3])
        signs = np.sign(np.diag(k))
        signs[signs == 0] = 1.0
        # K's last diagonal entry and two focal lengths positive; a left-handed P leaves det(R) = -1, as it is.
        return k * signs / (k * signs)[2, 2], signs[:, None] * r

    @property
    def intrinsics(self) -> FloatArray:
        """K (3, 3), px, upper triangular with positive focal lengths and ``K[2, 2] == 1``."""
        return self._k_r[0]

    @property
    def camera_from_world(self) -> FloatArray:
        """(4, 4), mm: x along u, y along v, z away from the source. A left-handed P gives a reflection."""
        rotation = self._k_r[1]
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ self.center_in_world_mm
        return pose

    @property
    def is_right_handed(self) -> bool:
        """Whether u right, v down and the depth form a right-handed frame, as in every image that is not mirrored."""
        return bool(np.linalg.det(self.projection[:, :3]) > 0)

    @property
    def viewing_axis_in_world(self) -> FloatArray:
        """Unit vector (3,) along which the depth grows: the normal of the detector, away from the source."""
        return self.projection[2, :3]

    def depth_mm(self, points_in_world_mm: FloatArray) -> FloatArray:
        """Distance from the source along the viewing axis, (N,), mm; negative behind the source. Points are (N, 3)."""
        points = np.atleast_2d(points_in_world_mm)
        return np.asarray(points @ self.projection[2, :3] + self.projection[2, 3], dtype=np.float64)

    def project(self, points_in_world_mm: FloatArray) -> FloatArray:
        """Project points onto the detector.

        Parameters
        ----------
        points_in_world_mm : (N, 3), or (3,) for one.

        Returns
        -------
        (N, 2), or (2,) for one; px, as (u, v).

        Raises
        ------
        BehindSourceError
            A point has depth <= 0.

        References
        ----------
        Hartley & Zisserman (2004), section 6.1.
        """
        points = np.asarray(points_in_world_mm, dtype=np.float64)
        homogeneous = np.atleast_2d(points) @ self.projection[:, :3].T + self.projection[:, 3]
        depth = homogeneous[:, 2]
        if not (depth > 0).all():
            index = int(np.argmin(depth))
            raise BehindSourceError(
                f"point {index} of {len(depth)} has depth {depth[index]:.4g} mm: it is not in front of the X-ray "
                "source. Is the projection matrix in the units and the frame of the points?"
            )
        pixels = homogeneous[:, :2] / depth[:, None]
        return np.asarray(pixels[0] if points.ndim == 1 else pixels, dtype=np.float64)

    def ray_directions_in_world(self, pixels: FloatArray) -> FloatArray:
        """Unit directions (N, 3), away from the source, of the rays that meet the detector at pixels (N, 2)."""
        uv1 = np.column_stack([np.atleast_2d(pixels), np.ones(len(np.atleast_2d(pixels)))])
        directions = np.linalg.solve(self.projection[:, :3], uv1.T).T
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True), dtype=np.float64)

    def mm_per_px_at(self, point_in_world_mm: FloatArray) -> float:
        """How many mm across the rays one pixel spans at the depth of a point (3,); the mean of u and v."""
        focal_px = float(np.sqrt(self.intrinsics[0, 0] * self.intrinsics[1, 1]))
        return float(self.depth_mm(point_in_world_mm)[0]) / focal_px
