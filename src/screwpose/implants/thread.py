"""Find a screw's thread in how far its sections reach in each direction."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray

SECTORS = 24
_STARTS = 3  # threads that may run side by side
_TURNS = 4  # fewer are no thread
_SHARE = 0.35  # of the relief's energy; the screws at hand have 0.5 and more, smooth or faceted tubes below 0.2
_RELIEF = 0.02  # of the radius: less is the faceting of a tube


@dataclass(frozen=True)
class Thread:
    """A helical relief.

    Parameters
    ----------
    pitch_mm : from one crest to the next along the axis.
    starts : threads that run side by side.
    right_handed : as nearly all bone screws are.
    depth_mm : from root to crest, as far as the sections show it.
    share : of the relief's energy that the helix explains, 0 to 1.
    """

    pitch_mm: float
    starts: int
    right_handed: bool
    depth_mm: float
    share: float


def find_thread(reach_mm: FloatArray, step_mm: float) -> Thread | None:
    """Look for a helix in the reach of a shank's sections.

    In the plane of height and angle a thread is a wave whose crests lean: one peak, with its overtones, in the
    two-dimensional spectrum. Grooves turned around a rod have crests that do not lean, flats along it have no wave.

    Parameters
    ----------
    reach_mm : (H, sectors), evenly spaced in height, counter-clockwise seen from the head.
    step_mm : between the heights.
    """
    rows, sectors = reach_mm.shape
    relief = _without_trend(_filled(reach_mm))
    if rows * step_mm <= 0.0 or float(np.std(relief)) < 0.5 * _RELIEF * float(np.nanmedian(reach_mm)):
        return None
    fine = 4 * rows  # padding: the pitch is read off finer than one turn in the whole length
    window = np.hanning(rows)[:, None]
    power = np.abs(np.fft.fft2(relief * window, s=(fine, sectors))) ** 2
    lowest, highest = 4 * _TURNS, fine // 6
    if highest <= lowest:
        return None
    best, where = 0.0, (0, 0)
    for order in [m for m in range(-_STARTS, _STARTS + 1) if m]:
        wave = power[lowest:highest, order % sectors]
        if wave.size and wave.max() > best:
            best, where = float(wave.max()), (lowest + int(wave.argmax()), order)
    peak, order = where
    if not order:
        return None
    share = _explained(power, peak, order)
    if share < _SHARE:
        return None
    pitch_mm = fine * step_mm / peak  # starts side by side pass a line along the axis one after the other
    depth = float(np.mean(np.percentile(relief, 95, axis=0) - np.percentile(relief, 5, axis=0)))
    # The wave cos(2 pi f z + order * angle) keeps its phase where the angle grows by -2 pi f z / order.
    return Thread(pitch_mm, abs(order), order < 0, depth, share)


def _explained(power: FloatArray, peak: int, order: int) -> float:
    """The energy at the peak and its overtones, with the mirrored half of the spectrum, of all energy."""
    fine, sectors = power.shape
    total = float(power.sum())
    near = np.arange(-8, 9)  # the width of the window's main lobe, padded
    held = 0.0
    for overtone in range(1, 5):
        if abs(overtone * order) > sectors // 2 or overtone * peak > fine // 2:
            break
        rows = (overtone * peak + near) % fine
        held += float(power[rows, (overtone * order) % sectors].sum())
    return min(1.0, 2.0 * held / total)


def _filled(reach: FloatArray) -> FloatArray:
    """Put each section's mean where a sector is empty, and the mean of all where a section is."""
    mean = np.nanmean(reach)
    known = np.isfinite(reach)
    count = known.sum(axis=1)
    rows = np.divide(np.where(known, reach, 0.0).sum(axis=1), count, out=np.full(len(reach), mean), where=count > 0)
    return np.where(known, reach, rows[:, None])


def _without_trend(reach: FloatArray) -> FloatArray:
    """Take off each sector's mean, slope and curvature along the axis: taper, flats, an axis that is a little off."""
    z = np.linspace(-1.0, 1.0, len(reach))
    basis = np.linalg.qr(np.stack([np.ones_like(z), z, z * z], axis=1))[0]
    return np.asarray(reach - basis @ (basis.T @ reach))
