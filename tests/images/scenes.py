"""X-rays drawn from formulas: Beer-Lambert through round rods and plates, with the mask known exactly."""

import numpy as np
from scipy.ndimage import gaussian_filter


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[:size, :size]
    return u.astype(float), v.astype(float)


def rod(
    size: int, start: tuple[float, float], end: tuple[float, float], radius_px: float, bore_px: float = 0.0
) -> np.ndarray:
    """Chord length in px through a round rod or tube lying in the image plane, with square ends."""
    u, v = grid(size)
    axis = np.subtract(end, start)
    length = float(np.hypot(*axis))
    along = ((u - start[0]) * axis[0] + (v - start[1]) * axis[1]) / length
    across = ((v - start[1]) * axis[0] - (u - start[0]) * axis[1]) / length

    def chord(radius: float) -> np.ndarray:
        return 2 * np.sqrt(np.maximum(radius**2 - across**2, 0))

    return np.where((along >= 0) & (along <= length), chord(radius_px) - chord(bore_px), 0.0)


def threaded(size: int, start: tuple[float, float], end: tuple[float, float], radius_px: float) -> np.ndarray:
    """A rod whose radius swings by 15 % every 8 px, as a thread does."""
    u, v = grid(size)
    axis = np.subtract(end, start)
    length = float(np.hypot(*axis))
    along = ((u - start[0]) * axis[0] + (v - start[1]) * axis[1]) / length
    across = ((v - start[1]) * axis[0] - (u - start[0]) * axis[1]) / length
    radius = radius_px * (1 + 0.15 * np.sin(2 * np.pi * along / 8 + np.sign(across) * np.pi / 2))
    inside = (along >= 0) & (along <= length)
    return np.where(inside, 2 * np.sqrt(np.maximum(radius**2 - across**2, 0)), 0.0)


def exposed(attenuation: np.ndarray, rng: np.random.Generator, counts: float = 3000.0, gain: float = 1.0) -> np.ndarray:
    """Transmitted intensity as a detector shows it, metal dark, in [0, 1], saturating at 1."""
    clean = gaussian_filter(np.exp(-attenuation), 0.9)
    return np.clip(gain * rng.poisson(clean * counts) / counts, 0, 1).astype(np.float32)


def spine_with_screws(seed: int, size: int = 768) -> tuple[np.ndarray, np.ndarray]:
    """(grey, metal dark; mask): two threaded shanks with paler towers, over a strong gradient, bone and open air."""
    rng = np.random.default_rng(seed)
    k = size / 768
    u, v = grid(size)
    body = 2.2 * np.sqrt(np.clip(1 - ((u - 300 * k) / (330 * k)) ** 2, 0, 1)) * (0.7 + 0.6 * v / size)
    bone = np.zeros_like(u)
    for level in range(5):
        box = np.maximum(abs(u - 260 * k) / (90 * k), abs(v - (80 + 150 * level) * k) / (55 * k))
        bone += 0.25 / (1 + np.exp((box - 1) * 20))
    bone += 0.06 * gaussian_filter(rng.standard_normal(u.shape), 5 * k) * 5 * k * (bone > 0.1)
    metal = np.zeros_like(u)
    for row, slope in ((250, 40), (420, -30)):
        tip = (230 * k, (row + slope + rng.uniform(-20, 20)) * k)
        head = (400 * k, row * k)
        end = (640 * k, (row - 1.41 * slope) * k)
        metal += threaded(size, tip, head, 10 * k) + rod(size, head, end, 22 * k, 18 * k)
    grey = exposed(body + gaussian_filter(bone, 2 * k) + 0.05 * metal / k, rng, gain=1.1)
    return grey, metal > 0


def dice(a: np.ndarray, b: np.ndarray) -> float:
    return 2.0 * float(np.sum(a & b)) / float(np.sum(a) + np.sum(b))
