"""DICOM projection X-rays (XA, RF, DX, CR) to greys, by pydicom and its decoder plugins.

What is done to the stored values, in the order of the standard (PS3.3 C.7.6.3, C.11.1): unused bits are cut off,
the modality LUT or the rescale is applied, MONOCHROME1 swaps black and white. The window (VOI) is a matter of display
and left alone, and so are overlays and shutters. Presentation LUT Shape INVERSE states MONOCHROME1 a second time (DX)
and must not invert twice.
"""

import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose.errors import ImageError
from screwpose.images.greys import Greys, NumberArray, grey_range
from screwpose.images.raster import first_frame_notes, refuse_absent_frame

_X_RAY = {
    "1.2.840.10008.5.1.4.1.1.1": "CR",
    "1.2.840.10008.5.1.4.1.1.1.1": "DX",
    "1.2.840.10008.5.1.4.1.1.1.1.1": "DX",  # for processing
    "1.2.840.10008.5.1.4.1.1.12.1": "XA",
    "1.2.840.10008.5.1.4.1.1.12.1.1": "XA",  # enhanced
    "1.2.840.10008.5.1.4.1.1.12.2": "RF",
    "1.2.840.10008.5.1.4.1.1.12.2.1": "RF",  # enhanced
}
_SECONDARY_CAPTURE = "1.2.840.10008.5.1.4.1.1.7"  # and .1 to .4, its multi-frame kinds
_MODALITIES = ("XA", "RF", "DX", "CR")
_EXPECTED = "a projection X-ray (XA, RF, DX or CR) with PixelData"

# What pydicom and its plugins raise on damaged files; ImageError itself is none of these.
_FOREIGN = (
    AttributeError,
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)


def has_dicom_preamble(data: bytes) -> bool:
    """Whether DICOM's mark stands behind the preamble, which may itself begin like a TIFF (PS3.10 7.1)."""
    return data[128:132] == b"DICM"


def looks_like_dicom(data: bytes) -> bool:
    """Whether the bytes are DICOM, with the 128-byte preamble or without.

    Without one a file starts with an element of group 0002 or 0008 whose number is even or small, in either byte order.
    """
    if has_dicom_preamble(data):
        return True
    if len(data) < 16:
        return False
    group, element = struct.unpack("<HH", data[:4])
    if group in (0x0200, 0x0800):
        group, element = struct.unpack(">HH", data[:4])
    return group in (0x0002, 0x0008) and element < 0x0100


def dicom_greys(data: bytes, path: Path, frame: int | None) -> Greys:
    """Decode one frame of a DICOM.

    Raises
    ------
    ImageError
        Damaged, not a projection X-ray, in colour, without PixelData, in a transfer syntax that no plugin decodes, or
        a frame that it does not have.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dataset = _read_dataset(data, path)
        notes = _refuse_other_than_grey_x_ray(dataset, path)
        try:
            count = int(dataset.get("NumberOfFrames") or 1)
            named = int(dataset.get("RepresentativeFrameNumber") or 0)  # counted from 1
            by_default = named - 1 if 1 <= named <= count else 0
            index = refuse_absent_frame(frame, count, path, by_default)
            stored = _decode(dataset, index if count > 1 else None)
            values, value_range, scale_notes = _modality_values(dataset, stored, path)
            shown_inverted = str(dataset.PhotometricInterpretation).strip() == "MONOCHROME1"
            metal_bright = _stated_metal_bright(dataset, shown_inverted)
            notes += _file_notes(dataset)
        except _FOREIGN as error:
            raise ImageError(
                f"its pixels cannot be decoded ({_one_line(error)}; transfer syntax {_transfer_syntax(dataset)})",
                file=path,
                field="PixelData",
                expected="a whole DICOM in a standard transfer syntax",
                remedy="Export it again, best uncompressed (Explicit VR Little Endian).",
            ) from error
    why = "its representative frame" if named else "the first"
    notes = first_frame_notes(frame, index, count, why) + notes + scale_notes
    notes += tuple(dict.fromkeys(f"DICOM reader: {_one_line(warning.message)}" for warning in caught))
    black, white, bits = value_range
    if shown_inverted:
        black, white = white, black
    return Greys(values, black, white, bits, notes, metal_bright)


def _read_dataset(data: bytes, path: Path) -> Any:
    import pydicom

    try:
        dataset = pydicom.dcmread(io.BytesIO(data), force=True)
        if "TransferSyntaxUID" not in dataset.file_meta:  # a file without preamble and meta header
            implicit, little = dataset.original_encoding
            dataset.file_meta.TransferSyntaxUID = (
                pydicom.uid.ImplicitVRLittleEndian
                if implicit
                else pydicom.uid.ExplicitVRLittleEndian
                if little
                else pydicom.uid.ExplicitVRBigEndian
            )
        return dataset
    except _FOREIGN as error:
        raise ImageError(
            f"it cannot be read as DICOM ({_one_line(error)})",
            file=path,
            expected=_EXPECTED,
            remedy="Export or copy the file again.",
        ) from error


def _refuse_other_than_grey_x_ray(dataset: Any, path: Path) -> tuple[str, ...]:
    uid = str(dataset.get("SOPClassUID") or "")
    modality = str(dataset.get("Modality") or "")
    notes: tuple[str, ...] = ()
    if uid == _SECONDARY_CAPTURE or uid.startswith(_SECONDARY_CAPTURE + "."):
        notes = ("A secondary capture: its greys may be processed, and text may be burned in.",)
    elif uid not in _X_RAY and not (not uid and modality in _MODALITIES):
        name = getattr(dataset.get("SOPClassUID"), "name", "") or "no SOP class"
        raise ImageError(
            f"this DICOM is {name} (modality {modality or 'not given'}), no projection X-ray",
            file=path,
            field="SOPClassUID",
            expected=_EXPECTED,
            remedy="Choose the image that the C-arm took.",
        )
    if not any(keyword in dataset for keyword in ("PixelData", "FloatPixelData", "DoubleFloatPixelData")):
        raise ImageError(
            "this DICOM has no pixel data",
            file=path,
            field="PixelData",
            expected=_EXPECTED,
            remedy="Fetch the whole object from the archive, not its header alone.",
        )
    photometric = str(dataset.get("PhotometricInterpretation") or "").strip()
    if photometric not in ("MONOCHROME1", "MONOCHROME2"):
        raise ImageError(
            f"the photometric interpretation is {photometric or 'not given'}",
            file=path,
            field="PhotometricInterpretation",
            expected="MONOCHROME1 or MONOCHROME2 (grey)",
            remedy="Export the X-ray itself, not a coloured screen shot of it.",
        )
    return notes


def _decode(dataset: Any, index: int | None) -> NumberArray:
    """The stored values of one frame, (rows, columns), sign and unused bits put right."""
    from pydicom.pixels.utils import pixel_array

    stored_bits, high_bit = int(dataset.BitsStored), int(dataset.get("HighBit") or 0)
    shift = high_bit - (stored_bits - 1)
    if shift <= 0 or dataset.file_meta.TransferSyntaxUID.is_encapsulated:
        return np.asarray(pixel_array(dataset, index=index))
    # Before 2014 the standard allowed the used bits to sit anywhere in the container.
    array = np.asarray(pixel_array(dataset, index=index, correct_unused_bits=False))
    unused = int(dataset.BitsAllocated) - high_bit - 1
    return (array << unused) >> (unused + shift)


def _modality_values(
    dataset: Any, stored: NumberArray, path: Path
) -> tuple[NumberArray, tuple[float, float, int], tuple[str, ...]]:
    """Modality values, their range (black, white, bits), and notes."""
    if stored.ndim != 2:
        raise ValueError(f"the decoded pixels have the shape {stored.shape}")
    black, white, bits, notes = grey_range(stored, int(dataset.BitsStored), path)
    if dataset.get("ModalityLUTSequence"):
        values, lut_bits = _through_lut(dataset, stored)
        return values, (0.0, float(2**lut_bits - 1), lut_bits), notes
    slope = float(1.0 if dataset.get("RescaleSlope") is None else dataset.RescaleSlope)
    intercept = float(dataset.get("RescaleIntercept") or 0.0)
    if slope == 0 or not np.isfinite([slope, intercept]).all():
        raise ValueError(f"RescaleSlope {slope:g} and RescaleIntercept {intercept:g} make no image")
    ends = sorted((slope * black + intercept, slope * white + intercept))
    return slope * stored.astype(np.float64) + intercept, (ends[0], ends[1], bits), notes


def _through_lut(dataset: Any, stored: NumberArray) -> tuple[NDArray[np.float64], int]:
    item = dataset.ModalityLUTSequence[0]
    count, first, bits = (int(number) for number in item.LUTDescriptor)
    data = item.LUTData
    order = "<" if dataset.file_meta.TransferSyntaxUID.is_little_endian else ">"
    lut = np.frombuffer(data, f"{order}u2") if isinstance(data, bytes) else np.asarray(data)
    lut = lut[: count or 65536].astype(np.float64)
    return lut[np.clip(stored.astype(np.int64) - first, 0, len(lut) - 1)], bits


def _stated_metal_bright(dataset: Any, shown_inverted: bool) -> bool | None:
    """Whether metal is shown bright by Pixel Intensity Relationship Sign (0028,1041), where it is given.

    +1: lower stored values mean less X-ray intensity, so metal is stored low; -1: metal is stored high.
    """
    sign = dataset.get("PixelIntensityRelationshipSign")
    if sign not in (1, -1):
        return None
    stored_high_is_shown_bright = not shown_inverted
    if not dataset.get("ModalityLUTSequence") and float(dataset.get("RescaleSlope") or 1.0) < 0:
        stored_high_is_shown_bright = not stored_high_is_shown_bright
    return bool((sign == -1) == stored_high_is_shown_bright)


def _file_notes(dataset: Any) -> tuple[str, ...]:
    notes = []
    relationship = str(dataset.get("PixelIntensityRelationship") or "").strip()
    if relationship and relationship != "LIN":
        meaning = {"LOG": "logarithmic", "DISP": "processed for display"}.get(relationship, "neither LIN nor LOG")
        notes.append(f"Pixel Intensity Relationship is {relationship} ({meaning}): greys are not linear in intensity.")
    if str(dataset.get("LossyImageCompression") or "").strip() == "01":
        notes.append("The image was compressed with loss: edges may have moved.")
    return tuple(notes)


def _transfer_syntax(dataset: Any) -> str:
    uid = getattr(getattr(dataset, "file_meta", None), "TransferSyntaxUID", None)
    return str(getattr(uid, "name", uid) or "not given")


def _one_line(error: object) -> str:
    return " ".join(str(error).split())
