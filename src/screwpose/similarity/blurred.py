"""A thickness model as a detector sees it: blurred before the logarithm, and with a response that may have a knee.

A detector blurs the intensity, and the logarithm comes after: what is blurred into the shadow of dense metal is bright,
so that its edges move inwards, by some 0.04 mm for a C-arm. Poses in cameras that are held hardly see that, since edges
move in from all sides. Cameras that are free do: the implant looks smaller, so that its view moves away from it, and
everything in it apart. So here the model begins with the length that the blurred intensity seems to have passed,
``L' = -log(G * exp(-mu L)) / mu``: G is the detector's blur, a Gaussian with a share of a screen's long tails, mu the
metal's attenuation. Scatter and display then make of it what they will, as long as it rises ever more slowly: a sum of
ramps. A sum of exponentials cannot have the knee where scatter or a black level ends the rise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.similarity.thickness import GradientTarget, cauchy_weights, near_metal, taps

# Detectors of C-arms have sigmas of 0.6 to 2 px, metals attenuate by 0.2 to 0.6 a mm, and half of the variance may be
# in the tails. The spreads are of the logarithms of the first two, and of the tail's logit. On simulated X-rays edges
# still lie 0.05 px further in, give or take 0.04: 0.01 mm, which in a free camera is a third of a millimetre of depth.
_USUAL = (np.log(0.85), np.log(0.3), 0.0, -0.05)
SPREADS = (0.35, 0.5, 1.5, 0.06)
PARAMETERS = len(_USUAL)
# A screen spreads light as two-sided exponentials, 1 / (1 + H f^2): a mixture of Gaussians whose variances themselves
# are distributed exponentially. Nodes of Gauss and Laguerre: weight, variance.
NODES = ((0.7110930099, 0.4157745568), (0.2785177336, 2.2942803603), (0.0103892565, 6.2899450829))
LEAST_SIGMA_PX = 0.05
LEAST_LIT = 1e-5  # goes through any metal: in single precision, 1 less it is still exact to a percent
# A pixel is a square. Drawn as one ray each, a wall that goes with a row of pixels covers the row or does not. By two
# rays by two errors have less of a common sign; two towers seen nearly end-on stay 0.2 mm off with 2, 3 or 4 alike.
FINE = 2
_STEP = 0.02
STEEP_PX = 0.8  # over which an edge's steepness is taken

# A ramp rises evenly up to its knee. Sums of them are whatever rises ever more slowly.
_KNEES_MM = (0.7, 1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 27.0, 40.0)
_ROUND = 4.0  # of a knee: its width is its place over this
LONGEST_MM = 80.0
_TABLE_MM = np.arange(0.0, LONGEST_MM + 0.02, 0.02)

_RIDGE = 1e-6  # ramps resemble each other

Gradients = NDArray[np.float32]
Rows = NDArray[np.float64] | NDArray[np.float32]


@dataclass(frozen=True)
class Blur:
    """A detector's blur before the logarithm; `parameters` is standardised: 0 what is usual, 1 a spread from it.

    Parameters
    ----------
    sigma_px : of the whole X-ray.
    per_mm : mu, how much metal attenuates.
    tail : logit of the share of the variance that is in the screen's tails.
    edge_px : of the whole X-ray, by how much edges lie further out than all this would put them.
    """

    sigma_px: float = float(np.exp(_USUAL[0]))
    per_mm: float = float(np.exp(_USUAL[1]))
    tail: float = _USUAL[2]
    edge_px: float = _USUAL[3]

    @property
    def parameters(self) -> FloatArray:
        """(4,), of sigma, attenuation, tail and edge."""
        own = np.array([np.log(self.sigma_px), np.log(self.per_mm), self.tail, self.edge_px])
        return np.asarray((own - _USUAL) / SPREADS)

    def then(self, step: FloatArray) -> "Blur":
        """With `parameters` changed by (4,)."""
        sigma, per_mm, tail, edge_px = (self.parameters + step) * SPREADS + _USUAL
        return Blur(float(np.exp(sigma)), float(np.exp(per_mm)), float(tail), float(edge_px))


@dataclass(frozen=True, eq=False)
class BlurredView:
    """How a blurred thickness model explains one view, and what its derivatives change with.

    Parameters
    ----------
    near : (N,), flat indices in the window of the pixels that are compared.
    residuals, weights : (2 N,), the image's derivatives minus the model's, along u, then along v; and robust weights.
    spread : robust standard deviation of the residuals on the model's edges.
    energy : the share of the image's gradient energy there that the model explains.
    slope : (rows, columns) of the window, how the response changes with the blurred path length, per mm.
    by_intrinsics : (3, 2 N), how the model's derivatives change with the logarithm of the focal length, then with the
        principal point in u and in v, px of the whole X-ray.
    by_blur : (4, 2 N), and with `Blur.parameters`.
    by_response : (n, 2 N), and with the weights of the response that are not 0.
    """

    near: NDArray[np.intp]
    residuals: FloatArray
    weights: FloatArray
    spread: float
    energy: float
    slope: FloatArray
    by_intrinsics: FloatArray
    by_blur: FloatArray
    by_response: FloatArray


def explain_blurred(
    target: GradientTarget,
    lengths_mm: FloatArray,
    window: tuple[slice, slice],
    blur: Blur,
    fine_mm: FloatArray | None = None,
) -> BlurredView | None:
    """Compare a thickness model with one view; None where nothing of it is in the image.

    Parameters
    ----------
    lengths_mm : (rows, columns) of the window: the path lengths of all bodies together.
    fine_mm : the same of every pixel's `FINE` by `FINE` parts, (FINE rows, FINE columns); None: a pixel is one ray.
    """
    lengths: ImageArray = np.clip(lengths_mm, 0.0, LONGEST_MM).astype(np.float32)
    near = np.flatnonzero(near_metal(target, lengths) & target.counts[window])
    if not len(near):
        return None
    seen = np.concatenate([image[window].ravel()[near] for image in (target.along_u, target.along_v)]).astype(float)
    table = ramps()
    own_px = model_px(target)
    if fine_mm is not None:
        lengths = np.clip(fine_mm, 0.0, LONGEST_MM).astype(np.float32)
    fine = lengths.shape[0] // lengths_mm.shape[0]
    through = _blurred(lengths, blur, target.scale, fine)
    rows = np.stack(
        [smoothed_derivatives(_looked_up(one, through), own_px, near, target.mean_px).ravel() for one in table]
    )
    response, residuals, weights, spread = _fitted(rows, seen)
    curve = response @ table
    image = _looked_up(curve, through)
    by_blur = []
    for step in np.eye(PARAMETERS) * _STEP:
        moved = _looked_up(curve, _blurred(lengths, blur.then(step), target.scale, fine))
        changed = (moved - image) / np.float32(_STEP)
        by_blur.append(smoothed_derivatives(changed, own_px, near, target.mean_px).ravel())
    return BlurredView(
        near=near,
        residuals=residuals,
        weights=weights,
        spread=spread,
        energy=1.0 - float(residuals @ residuals) / max(float(seen @ seen), 1e-300),
        slope=_looked_up(np.gradient(curve, _TABLE_MM), through).astype(np.float64),
        by_intrinsics=_by_intrinsics(target, image, own_px, window, near),
        by_blur=np.stack(by_blur).astype(float),
        by_response=rows[response > 0.0].astype(float),
    )


def without_response(information: FloatArray, gradient: FloatArray, kept: int) -> tuple[FloatArray, FloatArray]:
    """Normal equations of the first unknowns, the rest free: the response adapts to whatever moves.

    With the response held, steps fall short in just the directions that are weak, where a wider shadow and a steeper
    response look alike.
    """
    if len(gradient) == kept:
        return information, gradient
    size = np.sqrt(np.diag(information)[kept:] + 1e-300)
    own = information[kept:, kept:] / np.outer(size, size) + _RIDGE * np.eye(len(size))
    across = information[:kept, kept:] / size
    through = np.linalg.solve(own, np.column_stack([across.T, gradient[kept:] / size]))
    reduced = information[:kept, :kept] - across @ through[:, :-1]
    return 0.5 * (reduced + reduced.T), np.asarray(gradient[:kept] - across @ through[:, -1])


def derivatives_of_bodies(
    target: GradientTarget, blur: Blur, slope: FloatArray, by_motion: Gradients, inside: BoolArray
) -> FloatArray:
    """How the model's derivatives change with the motion of a body, (6, 2, n), at the n pixels of its window `inside`.

    Parameters
    ----------
    slope : (rows, columns) of the body's window.
    by_motion : (rows, columns, 6), how its path lengths change.
    """
    near = np.flatnonzero(inside)
    return np.stack(
        [
            smoothed_derivatives(slope * by_motion[:, :, k], total_px(target, blur), near, target.mean_px)
            for k in range(6)
        ]
    ).astype(float)


def smoothed_derivatives(image: Rows, sigma_px: float, near: NDArray[np.intp], mean_px: int = 0) -> Gradients:
    """Derivatives of an image smoothed by a Gaussian, along u and along v, (2, N), at N flat indices.

    Parameters
    ----------
    mean_px : see `thickness.taps`.
    """
    smooth, slope = taps(sigma_px, mean_px)
    return np.stack([_filtered(image, slope, smooth).ravel()[near], _filtered(image, smooth, slope).ravel()[near]])


def _by_intrinsics(
    target: GradientTarget, image: ImageArray, sigma_px: float, window: tuple[slice, slice], near: NDArray[np.intp]
) -> FloatArray:
    """With x and y the pixels from the principal point and m the image: a principal point that is further along u by 1
    makes ``-m_u`` of it, a focal length that is longer by a share e ``-e (x m_u + y m_v)``, which is
    ``-e ((x m)_u + (y m)_v - 2 m)``: convolutions of m, x m and y m, in which nothing is singular at the rims."""
    smooth, slope = taps(sigma_px, target.mean_px)
    plain, curve = _differences(sigma_px, target.mean_px)
    x = (np.arange(window[1].start, window[1].stop) - target.intrinsics[0, 2]).astype(np.float32)
    y = (np.arange(window[0].start, window[0].stop) - target.intrinsics[1, 2]).astype(np.float32)
    across, down = image * x, image * y[:, None]
    uu, uv = _filtered(image, curve, smooth), _filtered(image, slope, plain)
    vu, vv = _filtered(image, plain, slope), _filtered(image, smooth, curve)
    focal_u = _filtered(across, curve, smooth) + _filtered(down, slope, plain) - 2 * _filtered(image, slope, smooth)
    focal_v = _filtered(across, plain, slope) + _filtered(down, smooth, curve) - 2 * _filtered(image, smooth, slope)
    columns = [(focal_u, focal_v), (uu / target.scale, vu / target.scale), (uv / target.scale, vv / target.scale)]
    return -np.stack([np.concatenate([one.ravel()[near] for one in pair]) for pair in columns]).astype(float)


def _differences(sigma_px: float, mean_px: int) -> Sequence[Gradients]:
    """The derivatives of the taps of `thickness.taps`: of the Gaussian, and of what takes the derivative."""
    reach = (len(taps(sigma_px, mean_px)[0]) - 1) // 2
    x = np.arange(-reach, reach + 1, dtype=np.float64)
    smooth = np.exp(-0.5 * (x / sigma_px) ** 2)
    smooth /= smooth.sum()
    curve = (x**2 / sigma_px**4 - sigma_px**-2) * smooth
    if mean_px:
        curve -= np.convolve(curve, np.full(mean_px, 1.0 / mean_px), mode="same")
    return (x / sigma_px**2 * smooth).astype(np.float32), curve.astype(np.float32)


def model_px(target: GradientTarget) -> float:
    """The smoothing that makes a model as smooth as the target: both are means over pixels before."""
    return target.blur_px


def total_px(target: GradientTarget, blur: Blur) -> float:
    """The same, and of the blur before: what a change of the path lengths is smoothed by, about."""
    return float(np.hypot(model_px(target), blur.sigma_px / target.scale))


def _blurred(lengths_mm: ImageArray, blur: Blur, scale: int, fine: int = 1) -> ImageArray:
    """``-log(G * exp(-mu L)) / mu``: the lengths that the blurred intensity seems to have passed, mm."""
    lit = np.float32(1.0 - LEAST_LIT) * np.exp(np.float32(-blur.per_mm) * lengths_mm) + np.float32(LEAST_LIT)
    lit = lit.reshape(lit.shape[0] // fine, fine, lit.shape[1] // fine, fine).mean(axis=(1, 3))
    around = np.zeros_like(lit)
    tail = 1.0 / (1.0 + np.exp(-blur.tail))
    for weight, share in NODES:
        sigma_px = blur.sigma_px / scale * float(np.sqrt(1.0 - tail + tail * share))
        smooth, _ = taps(max(sigma_px, LEAST_SIGMA_PX))
        around += np.float32(weight) * _filtered(lit, smooth, smooth)
    seen = np.log(np.maximum(around, LEAST_LIT)) / np.float32(-blur.per_mm)
    smooth, slope = taps(STEEP_PX)
    steep = np.hypot(_filtered(seen, slope, smooth), _filtered(seen, smooth, slope))
    shifted = seen + np.float32(blur.edge_px / scale) * steep
    return np.asarray(np.clip(shifted, 0.0, LONGEST_MM), dtype=np.float32)


def _filtered(image: FloatArray | ImageArray, along_u: Gradients, along_v: Gradients) -> Gradients:
    import cv2

    pixels = np.ascontiguousarray(image, dtype=np.float32)
    return np.asarray(cv2.sepFilter2D(pixels, cv2.CV_32F, along_u, along_v, borderType=cv2.BORDER_REPLICATE))


def ramps() -> FloatArray:
    """(9, entries), the ramps at the path lengths of the table."""
    return np.stack([_ramp(knee) for knee in _KNEES_MM])


def _ramp(knee_mm: float) -> FloatArray:
    """Rises by 1 a mm up to about its knee, then no more, at the table's path lengths."""
    width = knee_mm / _ROUND
    return np.asarray(-width * np.log((np.exp(-_TABLE_MM / width) + np.exp(-_ROUND)) / (1.0 + np.exp(-_ROUND))))


def _looked_up(table: FloatArray, lengths_mm: Rows) -> ImageArray:
    place = lengths_mm * (1.0 / (_TABLE_MM[1] - _TABLE_MM[0]))
    below = place.astype(np.int32)
    upper = np.minimum(below + 1, len(table) - 1)
    single = table.astype(np.float32)
    share = (place - below).astype(np.float32)
    return np.asarray(single[below] + share * (single[upper] - single[below]), dtype=np.float32)


def _fitted(rows: Rows, seen: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Weights (9,) of the ramps that are not negative, robustly; the residuals, their weights, and their spread."""
    from scipy.optimize import nnls

    weights = np.ones(len(seen))
    basis: FloatArray = rows.astype(np.float64)
    for _ in range(2):
        matrix, right = (basis * weights) @ basis.T, (basis * weights) @ seen
        size = np.sqrt(np.diag(matrix) + 1e-300)
        root = np.linalg.cholesky(matrix / np.outer(size, size) + _RIDGE * np.eye(len(matrix)))
        response, _ = nnls(root.T, np.linalg.solve(root, right / size), maxiter=50 * len(matrix))
        response /= size
        model = response @ basis
        residuals = seen - model
        weights, spread = cauchy_weights(model, residuals)
    return np.asarray(response), residuals, weights, spread
