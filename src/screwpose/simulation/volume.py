"""CT volumes as the background of X-rays: Hounsfield units to the lengths of two materials."""

import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.errors import ImageError, ScrewposeError
from screwpose.simulation.materials import CORTICAL_BONE, MUSCLE, WATER, Material
from screwpose.simulation.spectra import xray_tables

# What a CT at 120 kV measures at: its effective energy behind a body's worth of tissue.
_CT_KEV = 70.0
# Below this there is no tissue: air beside the patient is noise about -1000.
_AIR_HU = -950.0


@dataclass(frozen=True, eq=False)
class CtVolume:
    """A CT volume in the world.

    Parameters
    ----------
    hu : (I, J, K), Hounsfield units at the voxels' centres.
    world_from_voxel : (4, 4): the world position in mm of the centre of voxel (i, j, k). Any affine map.
    """

    hu: NDArray[np.float32]
    world_from_voxel: FloatArray

    def __post_init__(self) -> None:
        if self.hu.ndim != 3 or min(self.hu.shape) < 2:
            raise ImageError(f"a CT volume of shape {self.hu.shape}", expected="three axes of 2 voxels or more")
        if not np.isfinite(self.hu).all():
            bad = int(np.count_nonzero(~np.isfinite(self.hu)))
            raise ImageError(f"{bad} voxels of a CT volume are not finite", expected="Hounsfield units")
        if self.world_from_voxel.shape != (4, 4) or abs(np.linalg.det(self.world_from_voxel)) < 1e-12:
            raise ImageError("a CT volume whose world_from_voxel has no inverse", expected="an affine map (4, 4) to mm")

    @property
    def materials(self) -> tuple[Material, Material]:
        """What the volume is made of: soft tissue and bone."""
        return MUSCLE, CORTICAL_BONE

    @cached_property
    def lengths_per_mm(self) -> NDArray[np.float32]:
        """(I, J, K, 2): how many mm of each of `materials` a mm of ray through a voxel counts as."""
        return np.ascontiguousarray(np.stack(two_materials(self.hu), axis=-1), dtype=np.float32)


def two_materials(hu: FloatArray | NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Hounsfield units as volume fractions of muscle and of cortical bone that a CT would measure alike.

    Up to muscle's own value the voxel is muscle of less density (fat, lung, gas); from there to cortical bone's a
    mixture of the two by volume; above, bone of more density.

    References
    ----------
    Two-material decomposition as of Schneider, Pedroni & Lomax (1996), Phys. Med. Biol. 41, 111, in its simplest form.
    """
    hu = np.asarray(hu, dtype=np.float64)
    muscle_hu, bone_hu = hounsfield_units(MUSCLE), hounsfield_units(CORTICAL_BONE)
    bone = np.maximum((hu - muscle_hu) / (bone_hu - muscle_hu), 0.0)
    thin = (hu + 1000.0) / (muscle_hu + 1000.0)
    soft = np.where(hu < _AIR_HU, 0.0, np.where(hu <= muscle_hu, thin, np.maximum(1.0 - bone, 0.0)))
    return np.asarray(soft), bone


def hounsfield_units(material: Material) -> float:
    """What a CT shows of a material: ``1000 (mu / mu of water - 1)`` at the CT's effective energy."""
    energy_kev = xray_tables().energy_kev
    mu, mu_of_water = (float(np.interp(_CT_KEV, energy_kev, item.linear_per_mm)) for item in (material, WATER))
    return 1000.0 * (mu / mu_of_water - 1.0)


def read_ct(path: str | Path) -> CtVolume:
    """Read a CT volume from a NIfTI file; the world is LPS in mm (NIfTI's is RAS).

    Raises
    ------
    ImageError
        The file is missing, broken, not three-dimensional, or says that it holds something else than mm.
    ScrewposeError
        The extra `ct` (nibabel) is not installed.
    """
    try:
        import nibabel
    except ImportError as error:
        raise ScrewposeError(
            f"{path}: CT volumes are read with nibabel, which is not installed. Install the extra: "
            "pip install 'screwpose[ct]'."
        ) from error
    expected = "a CT volume as NIfTI (.nii or .nii.gz)"
    try:
        image: Any = nibabel.load(path)
        hu = np.asarray(image.dataobj, dtype=np.float32)
    except FileNotFoundError as error:
        raise ImageError("there is no such file", file=path, expected=expected) from error
    except (nibabel.filebasedimages.ImageFileError, OSError, EOFError, ValueError, zlib.error) as error:
        raise ImageError(f"it cannot be read ({error})", file=path, expected=expected) from error
    header: Any = image.header
    unit = header.get_xyzt_units()[0] if isinstance(image, nibabel.Nifti1Image) else "not NIfTI"
    if unit not in ("mm", "unknown"):
        raise ImageError(f"its unit is {unit}", file=path, expected=f"{expected} in mm")
    if image.affine is None:
        raise ImageError("it does not say where its voxels are", file=path, expected=expected)
    # RAS to LPS: right and front become left and back.
    world_from_voxel = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.asarray(image.affine, dtype=np.float64)
    try:
        return CtVolume(hu, world_from_voxel)
    except ImageError as error:
        raise ImageError(error.problem, file=path, expected=error.expected) from error
