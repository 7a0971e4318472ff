"""How well does metal of a certain thickness explain an X-ray? Gradients of the image against those of the model.

A silhouette against a grey image is biased: the image has thickness gradients and inner edges that a mask has not. So
the path length L through the posed CAD is mapped by a response ``s(L)`` to what the detector made of it, and compared
with the log image in the gradient domain, where whatever is smooth, the patient and scatter, hardly counts. The
response is a sum of saturating exponentials with weights that are not negative: monotone, as beam hardening and any
display are, and fitted to each view by itself.

`explain` and what follows it are the reference, in NumPy and OpenCV; `assessment` does the same in compiled loops.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.errors import ImageError
from screwpose.geometry import Camera

GradientArray = NDArray[np.float32]

# Thicknesses over which the response saturates, mm: thick cobalt-chrome is opaque after 2, titanium after 20.
SATURATION_MM = np.array([0.7, 2.0, 6.0, 15.0, 40.0], dtype=np.float32)
# Longer paths no screw has; what an open mesh leaves behind must not overflow an exponential.
LONGEST_MM = 80.0
# Shorter ones are what rounding leaves where a body's walls cancel.
LEAST_MM = 1e-6
# Pixels on the model's edges, where its gradient exceeds this share of its 99th percentile, tell the residuals' scale.
RIM_SHARE = 0.15
CAUCHY = 2.385  # 95 % efficiency for Gaussian residuals: Holland & Welsch (1977)
REWEIGHTED = 2
SAMPLES = 20_000
# Where a target is local. What lies over and under the metal, and scatter, change its contrast from place to place: the
# model may be stronger or weaker there, as a mean over 15 px says. And where residuals are large over 9 px, be it a rib
# or a rim that the model does not know, they count for less. Held to 1, and to the spread of all, by these shares of a
# box full of pixels. Twice or half of each number changed errors of development cases by some hundredths.
GAIN_PX, GAIN_HOLD, MOST_GAIN = 7, 0.1, 3.0
SPREAD_PX, SPREAD_HOLD = 4, 0.03


@dataclass(frozen=True, eq=False)
class GradientTarget:
    """One X-ray at one scale, ready to be compared with thickness models.

    Parameters
    ----------
    intrinsics, camera_from_world : of the reduced image, (3, 3) px and (4, 4) mm; right-handed: a mirrored view is
        mirrored back, image and all.
    along_u, along_v : (rows, columns), derivatives of the smoothed log image, per px.
    counts : (rows, columns), the pixels whose derivatives see nothing beyond the region.
    scale : how many px of the X-ray make one.
    blur_px : of the smoothing, at this scale; of the models', where that is more: see `blurring`.
    mean_px : see `taps`.
    is_local : gain and noise are those of each place, see `localised`.
    """

    intrinsics: FloatArray
    camera_from_world: FloatArray
    along_u: GradientArray
    along_v: GradientArray
    counts: BoolArray
    scale: int
    blur_px: float
    mean_px: int = 0
    is_local: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.counts.shape[0], self.counts.shape[1]

    def blurring(self, more_px: float) -> "GradientTarget":
        """The same image, which is compared with models that are blurred by so much more, as the detector blurs."""
        return replace(self, blur_px=float(np.hypot(self.blur_px, more_px)))

    def differentiated(self, image: ImageArray) -> tuple[GradientArray, GradientArray]:
        """The same derivatives of a model's image, or of a part of one."""
        return _differentiated(image, self.blur_px, self.mean_px)


def make_gradient_target(
    log_pixels: ImageArray,
    region: BoolArray,
    camera: Camera,
    scale: int,
    blur_px: float = 1.3,
    mean_px: int = 0,
    is_local: bool = False,
) -> GradientTarget:
    """Prepare an X-ray.

    Parameters
    ----------
    log_pixels : (rows, columns), log of the greys, metal bright; see `screwpose.images.log_image`.
    region : (rows, columns), M_bg: the pixels that count.
    scale : how many px along each side become one.
    blur_px : sigma of the smoothing before differences are taken, at the reduced scale.
    mean_px, is_local : see `GradientTarget`.
    """
    import cv2

    rows, columns = region.shape
    if min(rows, columns) < scale * 8:
        raise ImageError(f"an image of {columns} x {rows} px cannot be reduced {scale} times")
    projection = camera.projection
    if not camera.is_right_handed:  # u runs the other way: turn it round, image and matrix
        mirror = np.array([[-1.0, 0.0, columns - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        projection, log_pixels, region = mirror @ projection, log_pixels[:, ::-1], region[:, ::-1]
    size = (columns // scale, rows // scale)
    used = (slice(0, size[1] * scale), slice(0, size[0] * scale))
    image: ImageArray = np.asarray(
        cv2.resize(np.ascontiguousarray(log_pixels[used], dtype=np.float32), size, interpolation=cv2.INTER_AREA),
        dtype=np.float32,
    )
    inside = cv2.resize(np.ascontiguousarray(region[used], dtype=np.float32), size, interpolation=cv2.INTER_AREA)
    reach = 2 * _reach_px(blur_px, mean_px) + 1
    counts = cv2.erode((inside > 0.999).astype(np.uint8), np.ones((reach, reach), np.uint8), borderValue=0)
    # Integer pixels are centres, so borders, not centres, coincide.
    reduced_from_full = np.array(
        [[1 / scale, 0.0, 0.5 / scale - 0.5], [0.0, 1 / scale, 0.5 / scale - 0.5], [0.0, 0.0, 1.0]]
    )
    reduced = Camera(reduced_from_full @ projection)
    along_u, along_v = _differentiated(image, blur_px, mean_px)
    return GradientTarget(
        reduced.intrinsics,
        reduced.camera_from_world,
        along_u,
        along_v,
        counts.astype(np.bool_),
        scale,
        blur_px,
        mean_px,
        is_local,
    )


def _reach_px(blur_px: float, mean_px: int = 0) -> int:
    return int(np.ceil(4.0 * blur_px)) + mean_px // 2


def taps(blur_px: float, mean_px: int = 0) -> tuple[GradientArray, GradientArray]:
    """The taps (2 reach + 1,) of a Gaussian and of its derivative, as a correlation takes them.

    Parameters
    ----------
    mean_px : odd; the derivative's mean over so many px, along its own direction, is taken off: what anatomy and the
        display add under the metal is an even slope over that far, metal's edges are not. 0 takes nothing off.
    """
    reach = _reach_px(blur_px, mean_px)
    x = np.arange(-reach, reach + 1, dtype=np.float64)
    smooth = np.exp(-0.5 * (x / blur_px) ** 2)
    smooth /= smooth.sum()
    slope = x / blur_px**2 * smooth
    if mean_px:
        slope -= np.convolve(slope, np.full(mean_px, 1.0 / mean_px), mode="same")
    return smooth.astype(np.float32), slope.astype(np.float32)


def _differentiated(image: ImageArray, blur_px: float, mean_px: int) -> tuple[GradientArray, GradientArray]:
    import cv2

    smooth, slope = taps(blur_px, mean_px)
    image = np.ascontiguousarray(image, dtype=np.float32)
    return (
        np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, slope, smooth, borderType=cv2.BORDER_REPLICATE)),
        np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, smooth, slope, borderType=cv2.BORDER_REPLICATE)),
    )


@dataclass(frozen=True, eq=False)
class Explanation:
    """How a thickness model explains one view.

    Parameters
    ----------
    response : (5,), the weights of the saturating exponentials.
    near : (rows, columns) of the window, the N pixels that were compared.
    residuals : (2, N), the image's derivatives minus the model's, along u and along v, per px.
    weights : (2, N), robust, 0 to 1; where the target is local, of the noise about each pixel over that of all.
    spread : robust standard deviation of the residuals on the model's edges.
    energy : the share of the image's gradient energy there that the model explains: 1 for all of it.
    gain : (N,), by which the model's derivatives were taken: 1 where the target is not local.
    """

    response: FloatArray
    near: BoolArray
    residuals: FloatArray
    weights: FloatArray
    spread: float
    energy: float
    gain: FloatArray

    def image_of(self, values: FloatArray) -> FloatArray:
        """Values (2, N) in their places, (2, rows, columns); 0 where nothing was compared."""
        image = np.zeros((2, self.near.size))
        image[:, np.flatnonzero(self.near)] = values
        return image.reshape(2, *self.near.shape)


def explain(target: GradientTarget, lengths_mm: FloatArray, window: tuple[slice, slice]) -> Explanation:
    """Fit the response to a model's path lengths, and see what is left.

    Parameters
    ----------
    lengths_mm : (rows, columns) of the window: the path lengths of all bodies together.
    window : the part of the image; outside it the lengths are 0.
    """
    lengths = clipped(lengths_mm)
    near = near_metal(target, lengths) & target.counts[window]
    flat = np.flatnonzero(near)
    if not len(flat):
        nothing = np.zeros((2, 0))
        return Explanation(np.zeros(len(SATURATION_MM)), near, nothing, nothing, 1.0, 0.0, nothing[0])

    def taken(along_u: GradientArray, along_v: GradientArray) -> GradientArray:
        return np.concatenate([along_u.ravel()[flat], along_v.ravel()[flat]])

    basis = np.empty((len(SATURATION_MM), 2 * len(flat)))
    for row, constant in zip(basis, SATURATION_MM, strict=True):
        row[:] = taken(*target.differentiated(1.0 - np.exp(lengths / -constant)))
    image = taken(target.along_u[window], target.along_v[window]).astype(np.float64)
    response, residuals, weights, spread = _fitted(basis, image)
    gain = np.ones(len(flat))
    if target.is_local:
        gain, residuals, weights = localised(near, image - residuals, image, weights, spread)
    energy = 1.0 - float(np.sum(residuals**2)) / max(float(np.sum(image**2)), 1e-300)
    return Explanation(response, near, residuals.reshape(2, -1), weights.reshape(2, -1), spread, energy, gain)


def localised(
    near: BoolArray, model: FloatArray, image: FloatArray, weights: FloatArray, spread: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Let gain and noise differ from place to place.

    Parameters
    ----------
    near : (rows, columns), the N pixels that are compared.
    model, image : (2 N,), derivatives along u, then along v.
    weights, spread : robust, of all pixels alike.

    Returns
    -------
    The gain (N,), the residuals (2 N,) that it leaves, and their weights (2 N,): by Cauchy, and by `spread` squared
    over the mean square of the residuals about each pixel.
    """
    import cv2

    def boxed(values: FloatArray, half_px: int) -> FloatArray:
        sums = np.zeros(near.shape)
        sums[near] = values
        size = (2 * half_px + 1, 2 * half_px + 1)
        return np.asarray(cv2.boxFilter(sums, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)[near])

    lower = np.sum((weights * model**2).reshape(2, -1), axis=0)
    hold = GAIN_HOLD * float(lower.mean()) * (2 * GAIN_PX + 1) ** 2 + 1e-30
    upper = boxed(np.sum((weights * model * image).reshape(2, -1), axis=0), GAIN_PX)
    gain = np.clip((upper + hold) / (boxed(lower, GAIN_PX) + hold), 1.0 / MOST_GAIN, MOST_GAIN)
    residuals = image - np.tile(gain, 2) * model
    # Squares beyond what is believed are cut, so that an outlier does not make its surroundings doubtful.
    squares = np.minimum(residuals**2, 4.0 * (CAUCHY * spread) ** 2).reshape(2, -1).mean(axis=0)
    hold = SPREAD_HOLD * (2 * SPREAD_PX + 1) ** 2
    about = (boxed(squares, SPREAD_PX) + hold * spread**2) / (boxed(np.ones(len(squares)), SPREAD_PX) + hold)
    return gain, residuals, spread**2 / (np.tile(about, 2) + (residuals / CAUCHY) ** 2)


def near_metal(target: GradientTarget, lengths_mm: FloatArray | ImageArray) -> BoolArray:
    """The pixels whose derivatives metal reaches, (rows, columns)."""
    import cv2

    reach = 2 * _reach_px(target.blur_px, target.mean_px) + 1
    is_metal = (lengths_mm > LEAST_MM).view(np.uint8)
    return np.asarray(cv2.dilate(is_metal, np.ones((reach, reach), np.uint8)).view(np.bool_))


def clipped(lengths_mm: FloatArray) -> ImageArray:
    """Path lengths as a screw can have them, float32."""
    return np.clip(lengths_mm, 0.0, LONGEST_MM).astype(np.float32)


def _fitted(basis: FloatArray, image: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Weights of the basis (5, 2 N) that are not negative, robustly; the residuals, their weights, and their spread."""
    from scipy.optimize import nnls

    weights = np.ones(len(image))
    ridge = 1e-9 * float(np.sum(basis**2)) * np.eye(len(basis))
    for _ in range(REWEIGHTED):
        # The normal equations: there are five unknowns, and a hundred thousand rows.
        response, _ = nnls((basis * weights) @ basis.T + ridge, basis @ (weights * image))
        model = sum(weight * one for weight, one in zip(response, basis, strict=True))
        residuals = image - model
        weights, spread = cauchy_weights(model, residuals)
    return np.asarray(response), residuals, weights, spread


def cauchy_weights(model: FloatArray, residuals: FloatArray) -> tuple[FloatArray, float]:
    """What each of N residuals counts for, and their spread: that of the model's steepest edges, the rims of metal."""
    step = max(1, len(residuals) // SAMPLES)  # order statistics need no more
    edges = np.abs(model[::step])
    rim = edges > RIM_SHARE * np.percentile(edges, 99)
    spread = 1.4826 * float(np.median(np.abs(residuals[::step][rim]))) if rim.any() else float(np.std(residuals))
    spread = max(spread, 1e-9)
    return 1.0 / (1.0 + (residuals / (CAUCHY * spread)) ** 2), spread


def response_slope(response: FloatArray, lengths_mm: FloatArray) -> ImageArray:
    """How the response changes with the path length, ``s'(L)``, per mm."""
    lengths = clipped(lengths_mm)
    slope = np.zeros_like(lengths)
    for weight, constant in zip(response, SATURATION_MM, strict=True):
        if weight > 0.0:
            slope += np.float32(weight / constant) * np.exp(lengths / -constant)
    return slope


def derivatives(target: GradientTarget, slope: ImageArray, by_motion: GradientArray) -> GradientArray:
    """How the model's derivatives change with a body's motion, the response held: (2, rows, columns, 6). Where the
    target is local, times its gain.

    Parameters
    ----------
    slope : (rows, columns) of the body's window, ``s'(L)`` of all bodies' lengths.
    by_motion : (rows, columns, 6), how this body's lengths change.
    """
    return np.stack(target.differentiated(slope[:, :, None] * by_motion))
