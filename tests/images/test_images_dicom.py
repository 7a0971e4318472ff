"""DICOM against files written here value by value, and against pydicom's bundled files made by other programs."""

from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    JPEG2000Lossless,
    JPEGLosslessSV1,
    JPEGLSLossless,
    RLELossless,
)

from screwpose.errors import ImageError
from screwpose.images import read_radiograph

XA = "1.2.840.10008.5.1.4.1.1.12.1"
BUNDLED = Path(pydicom.__file__).parent / "data" / "test_files"

# 12 bits in a container of 16, all of the range.
STORED = np.array([[0, 1000, 2000], [3000, 4000, 4095]], dtype=np.uint16)


def dataset(
    stored: np.ndarray, bits_stored: int = 12, transfer_syntax: str = ExplicitVRLittleEndian, **tags: Any
) -> Dataset:
    """An XA image; `stored` is (rows, columns) or (frames, rows, columns)."""
    ds = Dataset()
    ds.file_meta = FileMetaDataset()
    ds.file_meta.TransferSyntaxUID = transfer_syntax
    ds.SOPClassUID, ds.SOPInstanceUID, ds.Modality = XA, "1.2.3.4.5", "XA"
    ds.PatientName = "Phantom"
    ds.Rows, ds.Columns = stored.shape[-2:]
    ds.SamplesPerPixel, ds.PhotometricInterpretation = 1, "MONOCHROME2"
    ds.BitsAllocated, ds.BitsStored, ds.HighBit = 8 * stored.itemsize, bits_stored, bits_stored - 1
    ds.PixelRepresentation = int(stored.dtype.kind == "i")
    if stored.ndim == 3:
        ds.NumberOfFrames = stored.shape[0]
    order = ">" if transfer_syntax == ExplicitVRBigEndian else "<"
    ds.PixelData = stored.astype(stored.dtype.newbyteorder(order)).tobytes()
    ds["PixelData"].VR = "OW"
    for name, value in tags.items():
        if value is None:
            delattr(ds, name)
        else:
            setattr(ds, name, value)
    return ds


def saved(path: Path, ds: Dataset, preamble: bool = True) -> Path:
    if preamble:
        ds.save_as(path, enforce_file_format=True)
    else:
        implicit = ds.file_meta.TransferSyntaxUID == ImplicitVRLittleEndian
        del ds.file_meta
        ds.save_as(path, implicit_vr=implicit, little_endian=True)
    return path


def pixels(path: Path, **options: Any) -> np.ndarray:
    return read_radiograph(path, "metal-bright", **options).pixels


def refusal(path: Path, **options: Any) -> ImageError:
    with pytest.raises(ImageError) as caught:
        read_radiograph(path, **options)
    assert caught.value.file == path
    return caught.value


@pytest.mark.parametrize(
    "syntax", [ImplicitVRLittleEndian, ExplicitVRLittleEndian, ExplicitVRBigEndian, DeflatedExplicitVRLittleEndian]
)
def test_uncompressed(tmp_path: Path, syntax: str) -> None:
    got = read_radiograph(saved(tmp_path / "a.dcm", dataset(STORED, transfer_syntax=syntax)), "metal-dark")
    np.testing.assert_allclose(got.pixels, 1 - STORED / 4095, atol=1e-7)
    assert (got.bits, got.size, got.notes, got.metal_bright_in_file) == (12, (3, 2), (), False)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, ExplicitVRLittleEndian])
def test_without_preamble(tmp_path: Path, syntax: str) -> None:
    path = saved(tmp_path / "a", dataset(STORED, transfer_syntax=syntax), preamble=False)
    assert path.read_bytes()[128:132] != b"DICM"
    np.testing.assert_allclose(pixels(path), STORED / 4095, atol=1e-7)


def test_preamble_that_begins_like_a_tiff(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.dcm", dataset(STORED))
    path.write_bytes(b"II*\x00" + path.read_bytes()[4:])
    np.testing.assert_allclose(pixels(path), STORED / 4095, atol=1e-7)


def test_monochrome1_is_shown_inverted_once(tmp_path: Path) -> None:
    path = saved(
        tmp_path / "a.dcm", dataset(STORED, PhotometricInterpretation="MONOCHROME1", PresentationLUTShape="INVERSE")
    )
    dark = read_radiograph(path, "metal-dark")
    np.testing.assert_allclose(dark.pixels, STORED / 4095, atol=1e-7)
    assert dark.metal_bright_in_file
    np.testing.assert_allclose(pixels(path), 1 - STORED / 4095, atol=1e-7)


def test_rescale_keeps_its_place_in_the_range(tmp_path: Path) -> None:
    """A positive slope changes nothing of (value - black) / (white - black); a negative one inverts."""
    straight = saved(tmp_path / "a.dcm", dataset(STORED, RescaleSlope="2.5", RescaleIntercept="-100", RescaleType="US"))
    np.testing.assert_allclose(pixels(straight), STORED / 4095, atol=1e-6)
    inverted = saved(tmp_path / "b.dcm", dataset(STORED, RescaleSlope="-1", RescaleIntercept="4095", RescaleType="US"))
    np.testing.assert_allclose(pixels(inverted), 1 - STORED / 4095, atol=1e-6)


def test_modality_lut(tmp_path: Path) -> None:
    """LUT of 4 entries from stored value 1000 on, 10 bit; what lies beyond its ends takes the end's value."""
    item = Dataset()
    item.add_new("LUTDescriptor", "US", [4, 1000, 10])
    item.add_new("LUTData", "US", [1023, 600, 300, 0])
    item.ModalityLUTType = "US"
    stored = np.array([[0, 1000, 1001], [1002, 1003, 4095]], dtype=np.uint16)
    path = saved(tmp_path / "a.dcm", dataset(stored, ModalityLUTSequence=[item]))
    np.testing.assert_allclose(pixels(path) * 1023, [[1023, 1023, 600], [300, 0, 0]], atol=1e-3)


def test_window_is_left_alone(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.dcm", dataset(STORED, WindowCenter="100", WindowWidth="10"))
    np.testing.assert_allclose(pixels(path), STORED / 4095, atol=1e-7)


def test_unused_bits_and_sign(tmp_path: Path) -> None:
    """Overlay bits above the stored ones must not count, and 12-bit two's complement must be extended."""
    dirty = STORED | np.uint16(0xA000)
    np.testing.assert_allclose(pixels(saved(tmp_path / "a.dcm", dataset(dirty))), STORED / 4095, atol=1e-7)
    shifted = dataset((STORED << 4) | np.uint16(0xF), HighBit=15)  # 12 bits at the upper end: legal before 2014
    np.testing.assert_allclose(pixels(saved(tmp_path / "b.dcm", shifted)), STORED / 4095, atol=1e-7)
    middle = dataset((STORED << 2) | np.uint16(0xC003), HighBit=13)
    np.testing.assert_allclose(pixels(saved(tmp_path / "d.dcm", middle)), STORED / 4095, atol=1e-7)
    signed = np.array([[-2048, -1], [0, 2047]], dtype=np.int16)
    packed = (signed.view(np.uint16) & 0x0FFF).view(np.int16)
    got = read_radiograph(saved(tmp_path / "c.dcm", dataset(packed)), "metal-bright")
    np.testing.assert_allclose(got.pixels, (signed + 2048.0) / 4095, atol=1e-7)
    assert got.notes == ("Greys were scaled from their range -2048 to 2047.",)


def test_twelve_bits_said_to_be_sixteen(tmp_path: Path) -> None:
    got = read_radiograph(saved(tmp_path / "a.dcm", dataset(STORED, 16)), "metal-dark")
    np.testing.assert_allclose(got.pixels, 1 - STORED / 4095, atol=1e-7)
    assert got.notes == ("The brightest value is 4095: the 16-bit greys were read as 12 bit.",)


def test_frames(tmp_path: Path) -> None:
    run = np.stack([STORED, 4095 - STORED, STORED // 2])
    path = saved(tmp_path / "a.dcm", dataset(run))
    first = read_radiograph(path, "metal-bright")
    np.testing.assert_allclose(first.pixels, STORED / 4095, atol=1e-7)
    assert first.notes[0].startswith("The file has 3 frames and none was chosen: frame 0 (counted from 0, the first)")
    chosen = read_radiograph(path, "metal-bright", frame=1)
    np.testing.assert_allclose(chosen.pixels, 1 - STORED / 4095, atol=1e-7)
    assert chosen.notes == ()
    error = refusal(path, frame=3)
    assert "frame: frame 3 was asked for, and the file has 3; expected 0 to 2" in str(error)
    named = read_radiograph(saved(tmp_path / "b.dcm", dataset(run, RepresentativeFrameNumber=2)), "metal-bright")
    np.testing.assert_allclose(named.pixels, 1 - STORED / 4095, atol=1e-7)
    assert "frame 1 (counted from 0, its representative frame) was read" in named.notes[0]


def encoded(ds: Dataset, stored: np.ndarray, syntax: str) -> Dataset:
    """RLE and JPEG 2000 by pydicom's plugins, the others by imagecodecs: none decodes what it encoded itself."""
    if syntax in (RLELossless, JPEG2000Lossless):
        ds.compress(
            syntax, generate_instance_uid=False, encoding_plugin="pydicom" if syntax == RLELossless else "pylibjpeg"
        )
        return ds
    if syntax == JPEGLSLossless:
        code = imagecodecs.jpegls_encode(stored)
    else:
        code = imagecodecs.ljpeg_encode(stored, bitspersample=ds.BitsStored)
    ds.PixelData = encapsulate([code])
    ds["PixelData"].VR = "OB"
    ds["PixelData"].is_undefined_length = True
    ds.file_meta.TransferSyntaxUID = syntax
    return ds


@pytest.mark.parametrize("syntax", [RLELossless, JPEGLSLossless, JPEG2000Lossless, JPEGLosslessSV1])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_lossless_compression_is_exact(tmp_path: Path, syntax: str, bits: int) -> None:
    stored = np.random.default_rng(bits).integers(0, 2**bits, (33, 47), dtype=np.uint16)
    stored[0, :2] = 0, 2**bits - 1
    stored = stored.astype(np.uint8) if bits == 8 else stored
    ds = encoded(dataset(stored, bits), stored, syntax)
    got = pixels(saved(tmp_path / "a.dcm", ds)).astype(np.float64) * (2**bits - 1)
    np.testing.assert_array_equal(np.round(got), stored)
    np.testing.assert_allclose(got, stored, atol=0.01)


@pytest.mark.parametrize("name", ["MR_small_RLE", "MR_small_jp2klossless", "MR_small_jpeg_ls_lossless"])
def test_files_that_other_programs_compressed(tmp_path: Path, name: str) -> None:
    """pydicom's bundled MR slice, plain and compressed by GDCM, declared to be XA."""
    both = []
    for source in ("MR_small", name):
        ds = pydicom.dcmread(BUNDLED / f"{source}.dcm")
        ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = XA
        ds.save_as(tmp_path / f"{source}.dcm")
        both.append(pixels(tmp_path / f"{source}.dcm"))
    assert np.unique(both[0]).size > 100
    np.testing.assert_array_equal(both[1], both[0])


@pytest.mark.parametrize(
    ("sign", "photometric", "slope", "metal_bright"),
    [
        (1, "MONOCHROME2", "1", False),
        (-1, "MONOCHROME2", "1", True),
        (1, "MONOCHROME1", "1", True),
        (-1, "MONOCHROME1", "1", False),
        (1, "MONOCHROME2", "-1", True),
    ],
)
def test_stated_polarity(tmp_path: Path, sign: int, photometric: str, slope: str, metal_bright: bool) -> None:
    """Sign +1: low stored values are little X-ray, so metal is stored low. Metal is bright in the end, whatever."""
    tags = {
        "PhotometricInterpretation": photometric,
        "RescaleSlope": slope,
        "RescaleIntercept": "0",
        "RescaleType": "US",
    }
    path = saved(tmp_path / "a.dcm", dataset(STORED, PixelIntensityRelationshipSign=sign, **tags))
    want = 1 - STORED / 4095 if sign == 1 else STORED / 4095
    np.testing.assert_allclose(read_radiograph(path).pixels, want, atol=1e-6)
    shown = read_radiograph(path, "metal-bright" if metal_bright else "metal-dark")
    np.testing.assert_allclose(shown.pixels, want, atol=1e-6)


def test_notes(tmp_path: Path) -> None:
    tags = {"PixelIntensityRelationship": "LOG", "LossyImageCompression": "01"}
    notes = read_radiograph(saved(tmp_path / "a.dcm", dataset(STORED, **tags)), "metal-dark").notes
    assert notes == (
        "Pixel Intensity Relationship is LOG (logarithmic): greys are not linear in intensity.",
        "The image was compressed with loss: edges may have moved.",
    )
    capture = dataset(STORED, SOPClassUID="1.2.840.10008.5.1.4.1.1.7")
    assert "secondary capture" in read_radiograph(saved(tmp_path / "b.dcm", capture), "metal-dark").notes[0]


def test_no_projection_x_ray(tmp_path: Path) -> None:
    error = refusal(BUNDLED / "CT_small.dcm")
    assert "SOPClassUID: this DICOM is CT Image Storage (modality CT), no projection X-ray; expected a proj" in str(
        error
    )
    assert "Choose the image that the C-arm took." in str(error)
    assert "Ultrasound" in str(refusal(BUNDLED / "examples_rgb_color.dcm"))


def test_no_pixel_data(tmp_path: Path) -> None:
    error = refusal(saved(tmp_path / "a.dcm", dataset(STORED, PixelData=None)))
    assert "PixelData: this DICOM has no pixel data; expected a projection X-ray" in str(error)
    assert "not its header alone" in str(error)


def test_colour(tmp_path: Path) -> None:
    colour = dataset(np.zeros((2, 9), dtype=np.uint8), 8, PhotometricInterpretation="RGB", SamplesPerPixel=3, Columns=3)
    colour.PlanarConfiguration = 0
    error = refusal(saved(tmp_path / "a.dcm", colour))
    assert "PhotometricInterpretation: the photometric interpretation is RGB; expected MONOCHROME1" in str(error)


def test_truncated_and_inconsistent(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.dcm", dataset(STORED))
    path.write_bytes(path.read_bytes()[:-6])
    assert "PixelData: its pixels cannot be decoded" in str(refusal(path))
    ds = dataset(STORED)
    del ds.Rows
    assert "its pixels cannot be decoded" in str(refusal(saved(tmp_path / "b.dcm", ds)))
    zero = dataset(STORED, RescaleSlope="0", RescaleIntercept="0", RescaleType="US")
    assert "RescaleSlope 0 and RescaleIntercept 0 make no image" in str(refusal(saved(tmp_path / "c.dcm", zero)))
    header = saved(tmp_path / "d.dcm", dataset(STORED))
    header.write_bytes(header.read_bytes()[:140])
    assert refusal(header).expected is not None


def test_all_black(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.dcm", dataset(np.zeros((4, 4), dtype=np.uint16)))
    assert "all 4 x 4 pixels have the value 0 (all-black image)" in str(refusal(path))
