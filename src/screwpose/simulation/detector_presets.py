"""C-arms as one meets them in theatres: values for `Detector`, after data sheets and published measurements.

Each takes the image's size and pixel pitch, and gives lengths in px by the latter, so that the same machine can be
simulated with fewer, larger pixels. `dataclasses.replace` changes what a scene wants otherwise.
"""

from screwpose.simulation.detector import Detector


def _counts_per_mm2(dose_ngy: float, efficiency: float) -> float:
    """Effective quanta of a detector's dose: 30 photons / (mm^2 nGy) behind a patient (RQA 5 of IEC 62220-1)."""
    return 30.2 * dose_ngy * efficiency


def flat_panel(image_size: tuple[int, int] = (1024, 1024), pixel_mm: float = 0.3) -> Detector:
    """A recent C-arm: caesium iodide on silicon, grid, little glare, logarithmic display; a spot image of 300 nGy."""
    return Detector(
        image_size=image_size,
        pixel_mm=pixel_mm,
        peak_kv=90.0,
        blur_px=0.0,
        focal_spot_mm=0.5,
        screen_h_mm2=0.5,
        glare_fraction=0.02,
        glare_mm=25.0,
        grid_scatter=0.2,
        scatter_sigma_px=20.0 / pixel_mm,
        counts_per_px=_counts_per_mm2(300.0, 0.65) * pixel_mm**2,
        electronic_noise=10.0 * pixel_mm,
        bits=16,
        display="log",
        reference_grey=0.5,
        log_decades=2.0,
    )


def image_intensifier(image_size: tuple[int, int] = (1024, 1024), pixel_mm: float = 0.3) -> Detector:
    """An older C-arm: round field, veiling glare, pincushion and S distortion, television display; 150 nGy."""
    return Detector(
        image_size=image_size,
        pixel_mm=pixel_mm,
        peak_kv=85.0,
        blur_px=0.15 / pixel_mm,
        focal_spot_mm=0.6,
        screen_h_mm2=0.4,
        glare_fraction=0.12,
        glare_mm=20.0,
        grid_scatter=0.22,
        scatter_sigma_px=20.0 / pixel_mm,
        counts_per_px=_counts_per_mm2(150.0, 0.6) * pixel_mm**2,
        electronic_noise=12.0 * pixel_mm,
        bits=8,
        display="power",
        reference_grey=0.5,
        gamma=0.65,
        field_radius_px=0.5 * min(image_size) - 2.0 / pixel_mm,
        pincushion=0.03,
        s_distortion_rad=0.02,
    )


def low_dose(image_size: tuple[int, int] = (1024, 1024), pixel_mm: float = 0.3) -> Detector:
    """A single fluoroscopic frame of a flat panel, 40 nGy, not averaged over time."""
    return Detector(
        image_size=image_size,
        pixel_mm=pixel_mm,
        peak_kv=100.0,
        blur_px=0.0,
        focal_spot_mm=0.5,
        screen_h_mm2=0.6,
        glare_fraction=0.02,
        glare_mm=25.0,
        grid_scatter=0.25,
        scatter_sigma_px=20.0 / pixel_mm,
        counts_per_px=_counts_per_mm2(40.0, 0.65) * pixel_mm**2,
        electronic_noise=10.0 * pixel_mm,
        bits=8,
        display="log",
        reference_grey=0.5,
        log_decades=1.8,
    )


def exact(image_size: tuple[int, int] = (1024, 1024), pixel_mm: float = 0.3) -> Detector:
    """No blur but the pixel's, no scatter, no noise to speak of, 16 bits: what remains is the solver's own error."""
    return Detector(
        image_size=image_size,
        pixel_mm=pixel_mm,
        blur_px=0.0,
        scatter_fraction=0.0,
        counts_per_px=1e9,
        electronic_noise=0.0,
        bits=16,
    )
