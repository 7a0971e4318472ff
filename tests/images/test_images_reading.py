"""PNG and TIFF against files that other libraries wrote, and every kind of file that cannot be an X-ray."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from screwpose.errors import ImageError
from screwpose.images import encode_png, read_mask, read_radiograph
from tests.data import shared_data

GREYS_8 = np.array([[0, 51, 102], [153, 204, 255]], dtype=np.uint8)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(header: tuple[int, int, int, int], rows: list[bytes], *extra: bytes) -> bytes:
    """A PNG by hand: (width, height, bit depth, colour type) and packed rows."""
    data = zlib.compress(b"".join(b"\0" + row for row in rows))
    ihdr = struct.pack(">IIBBBBB", *header, 0, 0, 0)
    body = [chunk(b"IHDR", ihdr), *extra, chunk(b"IDAT", data), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def written(path: Path, image: np.ndarray) -> Path:
    """Written by OpenCV, which the reader does not use."""
    done, data = cv2.imencode(path.suffix, image)
    assert done
    path.write_bytes(data.tobytes())
    return path


def refusal(path: Path, **options: object) -> ImageError:
    with pytest.raises(ImageError) as caught:
        read_radiograph(path, **options)  # type: ignore[arg-type]  # keywords of the caller
    assert caught.value.file == path
    return caught.value


def test_eight_bit_values_by_hand(tmp_path: Path) -> None:
    path = written(tmp_path / "a.png", GREYS_8)
    dark = read_radiograph(path, "metal-dark")
    np.testing.assert_allclose(dark.pixels, [[1.0, 0.8, 0.6], [0.4, 0.2, 0.0]], atol=1e-7)
    assert dark.pixels.dtype == np.float32
    assert (dark.bits, dark.size, dark.path, dark.notes) == (8, (3, 2), path, ())
    assert not dark.metal_bright_in_file
    bright = read_radiograph(path, "metal-bright")
    np.testing.assert_allclose(bright.pixels, [[0.0, 0.2, 0.4], [0.6, 0.8, 1.0]], atol=1e-7)
    assert bright.metal_bright_in_file


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_sixteen_bit_is_exact(tmp_path: Path, suffix: str) -> None:
    greys = np.random.default_rng(1).integers(0, 65536, (40, 30), dtype=np.uint16)
    greys[0, :2] = 0, 65535
    path = written(tmp_path / f"a{suffix}", greys)
    got = read_radiograph(path, "metal-bright")
    assert got.bits == 16
    np.testing.assert_array_equal(np.round(got.pixels.astype(np.float64) * 65535).astype(np.uint16), greys)


@pytest.mark.parametrize("compression", [None, "lzw", "zlib", "packbits"])
@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_tiff_kinds(tmp_path: Path, compression: str | None, byteorder: str) -> None:
    greys = np.random.default_rng(2).integers(0, 65536, (64, 48), dtype=np.uint16)
    greys[0, :2] = 0, 65535
    tifffile.imwrite(tmp_path / "a.tif", greys, compression=compression, byteorder=byteorder, tile=(16, 16))
    got = read_radiograph(tmp_path / "a.tif", "metal-bright")
    np.testing.assert_allclose(got.pixels, greys / 65535, atol=1e-7)


def test_twelve_bits_in_sixteen_count_as_twelve(tmp_path: Path) -> None:
    greys = np.array([[0, 1000], [2000, 4095]], dtype=np.uint16)
    got = read_radiograph(written(tmp_path / "a.png", greys), "metal-dark")
    np.testing.assert_allclose(got.pixels, 1 - greys / 4095, atol=1e-6)
    assert got.bits == 12
    assert got.notes == ("The brightest value is 4095: the 16-bit greys were read as 12 bit.",)


def test_white_is_zero_tiff_is_shown_inverted(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", GREYS_8, photometric="miniswhite")
    got = read_radiograph(tmp_path / "a.tif", "metal-dark")
    np.testing.assert_allclose(got.pixels, GREYS_8 / 255, atol=1e-7)
    assert got.metal_bright_in_file  # nothing had to be inverted


def test_float_tiff(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.array([[-1.0, 0.0], [1.0, 3.0]], dtype=np.float32))
    got = read_radiograph(tmp_path / "a.tif", "metal-bright")
    np.testing.assert_allclose(got.pixels, [[0, 0.25], [0.5, 1]])
    assert got.notes == ("Floating-point greys were scaled from their range -1 to 3.",)
    tifffile.imwrite(tmp_path / "b.tif", np.array([[0.1, 0.9]], dtype=np.float32))
    np.testing.assert_allclose(read_radiograph(tmp_path / "b.tif", "metal-bright").pixels, [[0.1, 0.9]])
    tifffile.imwrite(tmp_path / "c.tif", np.array([[0.1, np.nan]], dtype=np.float32))
    assert "1 of its pixels are not finite numbers" in str(refusal(tmp_path / "c.tif"))


def test_pages_of_a_tiff(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.stack([GREYS_8, 255 - GREYS_8]), photometric="minisblack")
    first = read_radiograph(path, "metal-bright")
    np.testing.assert_allclose(first.pixels, GREYS_8 / 255, atol=1e-7)
    assert "has 2 frames and none was chosen: frame 0 (counted from 0, the first) was read" in first.notes[0]
    second = read_radiograph(path, "metal-bright", frame=1)
    np.testing.assert_allclose(second.pixels, 1 - GREYS_8 / 255, atol=1e-7)
    assert second.notes == ()
    error = refusal(path, frame=2)
    assert "frame 2 was asked for, and the file has 2; expected 0 to 1 (frames are counted from 0)" in str(error)


def test_palette_of_greys_is_looked_up(tmp_path: Path) -> None:
    # Index 0 is white and index 3 black: the opposite of the stored numbers.
    palette = chunk(b"PLTE", bytes(value for grey in (255, 170, 85, 0) for value in (grey, grey, grey)))
    (tmp_path / "a.png").write_bytes(png((4, 2, 2, 3), [bytes([0b00011011]), bytes([0b11100100])], palette))
    got = read_radiograph(tmp_path / "a.png", "metal-bright")
    np.testing.assert_allclose(got.pixels, [[1, 2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3, 1]], atol=1e-7)
    colormap = np.tile((np.arange(256)[::-1] * 257).astype(np.uint16), (3, 1))
    tifffile.imwrite(tmp_path / "b.tif", GREYS_8, photometric="palette", colormap=colormap)
    got = read_radiograph(tmp_path / "b.tif", "metal-bright")
    np.testing.assert_allclose(got.pixels, 1 - GREYS_8 / 255, atol=1e-7)


def test_one_bit_png(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png((8, 1, 1, 0), [bytes([0b10110001])]))
    got = read_radiograph(tmp_path / "a.png", "metal-bright")
    np.testing.assert_array_equal(got.pixels, [[1, 0, 1, 1, 0, 0, 0, 1]])


def test_equal_channels_and_alpha(tmp_path: Path) -> None:
    opaque = np.dstack([GREYS_8] * 3 + [np.full_like(GREYS_8, 255)])
    got = read_radiograph(written(tmp_path / "a.png", opaque), "metal-bright")
    np.testing.assert_allclose(got.pixels, GREYS_8 / 255, atol=1e-7)
    assert got.notes == ("The transparency channel was left out.", "Three equal colour channels were read as grey.")
    opaque[0, 0, 3] = 10
    got = read_radiograph(written(tmp_path / "b.png", opaque), "metal-bright")
    assert got.notes[0].startswith("The transparency channel was left out; 17% of the pixels")
    tifffile.imwrite(tmp_path / "c.tif", np.stack([GREYS_8] * 3), photometric="rgb", planarconfig="separate")
    got = read_radiograph(tmp_path / "c.tif", "metal-bright")
    np.testing.assert_allclose(got.pixels, GREYS_8 / 255, atol=1e-7)


def test_colour_is_refused(tmp_path: Path) -> None:
    colour = np.dstack([GREYS_8] * 3)
    colour[1, 2] = 10, 20, 255  # blue, green, red for OpenCV
    error = refusal(written(tmp_path / "a.png", colour))
    assert "colour image" in str(error)
    assert "the first at column 2, row 1 is [255, 20, 10]" in str(error)
    assert error.remedy == "Export the X-ray itself as grey, without coloured annotations."


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("empty.png", b"", "the file is empty; expected a PNG, TIFF (8 or 16 bit, grey) or DICOM"),
        ("a.jpg", b"\xff\xd8\xff\xe0" + bytes(200), "it is a JPEG file"),
        ("a.png", b"hello, this is not an image at all" * 9, "it is of no known image format"),
        ("a.tif", b"II*\x00\x08\x00\x00\x00\x05", "cannot be decoded as TIFF"),
        ("b.png", b"\x89PNG\r\n\x1a\n", "it cannot be decoded as PNG (it ends too early)"),
    ],
)
def test_not_an_image(tmp_path: Path, name: str, content: bytes, text: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert text in str(refusal(tmp_path / name))


@pytest.mark.parametrize(("suffix", "kind"), [(".png", "PNG"), (".tiff", "TIFF")])
def test_truncated_and_damaged(tmp_path: Path, suffix: str, kind: str) -> None:
    image = np.random.default_rng(3).integers(0, 65536, (50, 50), dtype=np.uint16)
    path = tmp_path / f"a{suffix}"
    if kind == "PNG":
        written(path, image)
    else:
        tifffile.imwrite(path, image, compression="zlib")  # the directory comes first, the pixels after it
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    error = refusal(path)
    assert f"it cannot be decoded as {kind} (" in str(error)
    assert error.remedy == "Export or copy the file again."


def test_tiff_cut_before_its_directory(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tiff", np.random.default_rng(3).integers(0, 65536, (50, 50), dtype=np.uint16))
    path.write_bytes(path.read_bytes()[:3000])  # OpenCV writes the directory last
    assert "this TIFF holds no image, or is cut off" in str(refusal(path))


def test_missing_and_folder(tmp_path: Path) -> None:
    error = refusal(tmp_path / "none.png")
    assert "there is no such file" in str(error)
    assert "Check the path and its spelling." in str(error)
    assert "it is a folder" in str(refusal(tmp_path))


def test_one_value(tmp_path: Path) -> None:
    black = written(tmp_path / "a.png", np.zeros((4, 6), dtype=np.uint8))
    assert "all 6 x 4 pixels have the value 0 (all-black image)" in str(refusal(black))
    grey = written(tmp_path / "b.png", np.full((4, 6), 9, dtype=np.uint8))
    assert "all 6 x 4 pixels have the value 9; expected an X-ray with contrast" in str(refusal(grey))


def test_auto_says_when_it_guessed(tmp_path: Path) -> None:
    ramp = np.tile(np.arange(256, dtype=np.uint8), (256, 1))
    got = read_radiograph(written(tmp_path / "a.png", ramp))
    assert "could not be told from the image: metal-dark was assumed" in got.notes[0]
    np.testing.assert_allclose(got.pixels, 1 - ramp / 255, atol=1e-6)


def test_mask(tmp_path: Path) -> None:
    mask = np.array([[0, 1, 255], [0, 0, 7]], dtype=np.uint8)
    want = mask > 0
    np.testing.assert_array_equal(read_mask(written(tmp_path / "a.png", mask), (3, 2)), want)
    np.testing.assert_array_equal(read_mask(written(tmp_path / "b.tiff", mask), (3, 2)), want)
    painted = np.dstack([np.zeros_like(mask), np.zeros_like(mask), mask, np.full_like(mask, 255)])
    np.testing.assert_array_equal(read_mask(written(tmp_path / "c.png", painted), (3, 2)), want)
    np.testing.assert_array_equal(read_mask(written(tmp_path / "d.png", np.full_like(mask, 3)), (3, 2)), want | True)


def test_mask_refusals(tmp_path: Path) -> None:
    mask = written(tmp_path / "a.png", np.ones((2, 3), dtype=np.uint8))
    with pytest.raises(ImageError, match=r"the mask is 3 x 2 px and its X-ray 4 x 2; expected 4 x 2 px\."):
        read_mask(mask, (4, 2))
    with pytest.raises(ImageError, match="black all over: nothing would count"):
        read_mask(written(tmp_path / "b.png", np.zeros((2, 3), dtype=np.uint8)), (3, 2))
    with pytest.raises(ImageError, match="there is no such file"):
        read_mask(tmp_path / "none.png", (3, 2))
    (tmp_path / "c.png").write_bytes(b"GIF89a" + bytes(20))
    with pytest.raises(ImageError, match="it is a GIF file; expected a mask as PNG or TIFF"):
        read_mask(tmp_path / "c.png", (3, 2))
    (tmp_path / "d.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(ImageError, match="cannot be decoded as PNG"):
        read_mask(tmp_path / "d.png", (3, 2))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4)])
def test_encode_png_against_opencv(dtype: type, shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(4).integers(0, np.iinfo(dtype).max + 1, shape, dtype=dtype)
    got = cv2.imdecode(np.frombuffer(encode_png(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    if len(shape) == 3:
        got = got[..., [2, 1, 0, 3][: shape[2]]]
    np.testing.assert_array_equal(got, pixels)


def test_encode_png_of_masks_and_refusals() -> None:
    mask = np.array([[True, False]])
    got = cv2.imdecode(np.frombuffer(encode_png(mask), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(got, [[255, 0]])
    with pytest.raises(ValueError, match="uint8 or uint16, not float32"):
        encode_png(np.zeros((2, 2), dtype=np.float32))
    with pytest.raises(ValueError, match=r"not \(2, 2, 2\)"):
        encode_png(np.zeros((2, 2, 2), dtype=np.uint8))


def test_real_tiff() -> None:
    path = shared_data("calibration_formats/xr_rad_uln_cam01_UND.0099.tif")
    got = read_radiograph(path)
    assert (got.size, got.bits, got.notes) == ((1760, 1760), 8, ())
    with tifffile.TiffFile(path) as file:
        np.testing.assert_allclose(got.pixels, 1 - file.pages[0].asarray() / 255, atol=1e-6)
