"""Simple pure steps from a radiograph to what a metric compares: log, background removal, smoothing."""

import numpy as np

from screwpose._types import BoolArray, ImageArray

LOG_FLOOR = 3.0 / 255.0
"""Least grey before the logarithm: below some 3 counts of 8 bit it would turn noise into contrast."""


def log_image(pixels: ImageArray) -> ImageArray:
    """Turn greys into attenuation: -log of the transmitted share, so that metal adds up along a ray.

    Parameters
    ----------
    pixels : (rows, columns), metal bright, in [0, 1]; 1 - pixels is taken for the transmitted intensity.

    Returns
    -------
    (rows, columns), float32, metal bright: 0 where pixels are 0, 1 where at most 3/255 of the beam is left.
    """
    transmitted = np.maximum(1.0 - np.asarray(pixels, dtype=np.float32), np.float32(LOG_FLOOR))
    return np.asarray(np.log(transmitted) / np.float32(np.log(LOG_FLOOR)), dtype=np.float32)


def smoothed(pixels: ImageArray, sigma_px: float) -> ImageArray:
    """Gaussian smoothing; 0 px returns the pixels as they are. Beyond the border the border's value goes on."""
    if sigma_px < 0:
        raise ValueError(f"sigma_px is {sigma_px:g}, expected 0 or more")
    if sigma_px == 0:
        return pixels
    import cv2

    image = np.asarray(pixels, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE))


def background(pixels: ImageArray, region: BoolArray, sigma_px: float) -> ImageArray:
    """The mean of the pixels round each pixel, counting those inside the region alone (normalised convolution).

    Parameters
    ----------
    pixels : (rows, columns)
    region : (rows, columns), as of the field of view; what lies outside does not leak in.
    sigma_px : of the Gaussian weights; above 4 px it is computed on a reduced grid.

    Returns
    -------
    (rows, columns), float32. Where no part of the region is near, the mean over the region.
    """
    import cv2

    if not region.any():
        raise ValueError("the region is empty: there is no background in it")
    image = np.asarray(pixels, dtype=np.float32)
    weight = region.astype(np.float32)
    mean = np.float32(image[region].mean())
    # A smooth function needs few samples: sigma of about 2 px on the reduced grid.
    step = max(1, int(sigma_px / 2.0))
    size = (max(1, -(-image.shape[1] // step)), max(1, -(-image.shape[0] // step)))
    numerator = cv2.resize((image - mean) * weight, size, interpolation=cv2.INTER_AREA)
    denominator = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
    numerator = cv2.GaussianBlur(numerator, (0, 0), sigma_px / step, borderType=cv2.BORDER_REFLECT)
    denominator = cv2.GaussianBlur(denominator, (0, 0), sigma_px / step, borderType=cv2.BORDER_REFLECT)
    shape = (image.shape[1], image.shape[0])
    numerator = cv2.resize(numerator, shape, interpolation=cv2.INTER_LINEAR)
    denominator = cv2.resize(denominator, shape, interpolation=cv2.INTER_LINEAR)
    return np.asarray(mean + numerator / np.maximum(denominator, 1e-4), dtype=np.float32)


def flattened(pixels: ImageArray, region: BoolArray, sigma_px: float) -> ImageArray:
    """Remove the slowly varying background: pixels minus `background`, and 0 outside the region."""
    flat = np.asarray(pixels, dtype=np.float32) - background(pixels, region, sigma_px)
    return np.where(region, flat, np.float32(0.0))


def carried_outwards(pixels: ImageArray, region: BoolArray) -> ImageArray:
    """Give each pixel outside the region the value of the nearest one inside, so that its edge is no structure.

    Parameters
    ----------
    pixels : (rows, columns)
    region : (rows, columns), not empty.
    """
    import cv2

    if region.all():
        return pixels
    _, labels = cv2.distanceTransformWithLabels(
        (~region).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    nearest = np.zeros(int(labels.max()) + 1, dtype=np.float32)
    nearest[labels[region]] = pixels[region]
    return np.where(region, pixels, nearest[labels]).astype(np.float32)
