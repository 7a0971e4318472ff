"""What the package offers, and that asking for it is quick."""

import subprocess
import sys

import screwpose.images as images


def test_public_names() -> None:
    assert sorted(images.__all__) == images.__all__
    assert set(images.__all__) == {
        "Polarity", "Radiograph", "background", "carried_outwards", "detect_polarity", "encode_png", "field_of_view",
        "flattened", "log_image", "metal_target", "read_mask", "read_radiograph", "smoothed",
    }  # fmt: skip
    for name in images.__all__:
        assert getattr(images, name).__doc__


def test_slow_libraries_wait() -> None:
    slow = "'cv2', 'pydicom', 'tifffile', 'imagecodecs', 'scipy'"
    code = f"import sys, screwpose.images; print([m for m in ({slow}) if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
