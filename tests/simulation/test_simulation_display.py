"""From signal to greys: monotone, invertible where it says so, dark or bright, round, 8 to 16 bits."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.simulation.detector import Detector, displayed

RISING = np.geomspace(2e-4, 300.0, 400)[None, :]


@pytest.mark.parametrize("display", ["log", "power", "window"])
@pytest.mark.parametrize("bits", [8, 12, 16])
def test_display_rises_with_the_signal(display, bits):
    grey = displayed(RISING, Detector(display=display, bits=bits))[0]
    assert grey.dtype == (np.uint8 if bits == 8 else np.uint16)
    steps = np.diff(grey.astype(int))
    assert np.all(steps >= 0)
    assert grey[0] <= 0.05 * (2**bits - 1)
    assert grey[-1] > 0.9 * (2**bits - 1)
    dark_as_bright = displayed(RISING, Detector(display=display, bits=bits, metal_dark=False))[0]
    assert np.abs(dark_as_bright.astype(int) + grey.astype(int) - (2**bits - 1)).max() <= 1


@pytest.mark.parametrize("display", ["log", "power"])
def test_metal_in_open_air_stays_visible(display):
    detector = Detector(display=display, bits=12, reference_grey=0.5)
    grey = displayed(np.array([[0.0, 0.1, 0.3, 1.0, 3.0, 30.0, 100.0, 300.0]]), detector)
    assert grey[0, 3] == 2048
    assert np.all(np.diff(grey[0, 1:].astype(int)) > 0.05 * 4095)  # 1 mm of titanium in open air takes half away
    assert grey[0, -1] == pytest.approx(0.97 * 4095, rel=0.005)


@pytest.mark.parametrize(
    ("display", "inverse"),
    [
        ("log", lambda grey: 10.0 ** ((grey - 0.45) * 2.2)),
        ("power", lambda grey: (grey / 0.45) ** (1.0 / 0.6)),
        ("window", lambda grey: 0.5 + 2.0 * grey),
    ],
)
def test_below_the_reference_the_signal_can_be_had_back(display, inverse):
    signal = np.linspace(0.55, 1.0, 50)[None, :]
    detector = Detector(display=display, bits=16, window_center=1.5, window_width=2.0)
    np.testing.assert_allclose(inverse(displayed(signal, detector) / 65535.0), signal, rtol=2e-4)


def test_windows_cut_off_and_combine():
    detector = Detector(display="window", window_center=1.0, window_width=1.0, bits=8)
    np.testing.assert_array_equal(
        displayed(np.array([[0.2, 0.5, 1.0, 1.25, 1.5, 9.0]]), detector), [[0, 0, 128, 191, 255, 255]]
    )
    # A log display, and of its greys those from 0.35 to 0.55 spread over all: 0.45 is in the middle.
    narrow = replace(detector, display="log", grey_window=(0.45, 0.2))
    plain = replace(detector, display="log")
    signal = np.array([[0.5, 0.9, 1.0, 1.1]])
    spread, before = (displayed(signal, one)[0].astype(int) for one in (narrow, plain))
    assert spread[2] == 128
    np.testing.assert_allclose(spread[1:] - 127.5, (before[1:] - 0.45 * 255) * 5.0, atol=3.0)
    assert spread[0] == 0
    assert before[0] > 60


def test_round_field_is_black_outside():
    signal = np.ones((101, 121))
    for metal_dark, inside in ((True, 0.45), (False, 0.55)):
        grey = displayed(signal, Detector(image_size=(121, 101), field_radius_px=40.0, metal_dark=metal_dark))
        v, u = np.indices(signal.shape)
        radius = np.hypot(u - 60, v - 50)
        assert grey.dtype == np.uint8
        assert not grey[radius > 40.6].any()
        assert (grey[radius < 39.4] == round(inside * 255)).all()
