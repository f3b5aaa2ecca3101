"""Any projector with a display input: what it draws, and what it says it shows."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.display import DisplayProjector
from drivers.display.device import light_table, pixel_table, srgb_light, srgb_values
from drivers.display.screen import DisplayInfo
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CapabilityError, ConfigError, DeviceError, SettingError
from fpplab.devices import State
from fpplab.patterns.fringes import Pattern
from tests.drivers.x_screen import x_server

SIZE = (40, 30)
RAMP = np.arange(SIZE[0] * SIZE[1], dtype=np.uint64).reshape(SIZE[::-1]).astype(np.uint8)


class Watched:
    """In place of the window: keeps what was shown."""

    info = DisplayInfo(1, "HDMI-1", SIZE, 50, False)
    vsync_s = 0.02

    def __init__(self) -> None:
        self.shown: list[tuple[NDArray[np.uint8], int | None]] = []
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def show(self, frame: NDArray[np.uint8], refreshes: int | None = None) -> None:
        self.shown.append((frame.copy(), refreshes))

    def close(self) -> None:
        self.is_open = False


class Bench:
    def __init__(self) -> None:
        self.display = Watched()


def made(bench: Bench, **options: Any) -> DisplayProjector:
    return DisplayProjector("projector", {"display": 1, **options}, bench)


def test_the_curve_is_that_of_the_standard() -> None:
    """IEC 61966-2-1: half of full scale gives 21.4 % of the light, and the lowest values a straight line."""
    assert srgb_light(0.5) == pytest.approx(0.21404114, abs=1e-8)
    assert srgb_light(0.04) == pytest.approx(0.04 / 12.92)
    assert float(srgb_light(1.0)) == pytest.approx(1.0)
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_values(srgb_light(values)), values, atol=1e-7)


def test_light_shown_is_that_of_the_pixels_drawn() -> None:
    pixels, light = pixel_table(True), light_table(True)
    greys = np.arange(256)
    assert pixels[0] == 0
    assert pixels[255] == 255
    assert np.abs(light[pixels].astype(int) - greys).max() == 1  # pixel values are up to 2.3 greys apart
    np.testing.assert_array_equal(light[pixels[light[pixels]]], light[pixels])
    np.testing.assert_array_equal(pixel_table(False), greys)
    np.testing.assert_array_equal(light_table(False), greys)


def test_pixels_are_drawn_one_to_one_in_every_colour() -> None:
    bench = Bench()
    with made(bench) as projector:
        (shown,) = projector.load([Pattern("ramp", RAMP)])
        np.testing.assert_array_equal(shown.image, RAMP)
        projector.show(0)
        np.testing.assert_array_equal(bench.display.shown[-1][0], np.repeat(RAMP[..., None], 3, axis=2))
        projector.blank()
        assert not bench.display.shown[-1][0].any()
    assert not bench.display.is_open


def test_loading_is_dark() -> None:
    bench = Bench()
    with made(bench) as projector:
        projector.load([Pattern("ramp", RAMP)])
        projector.show(0)
        projector.load([Pattern("ramp", RAMP)])
        assert not bench.display.shown[-1][0].any()


def test_with_srgb_the_light_is_as_the_plan_has_it() -> None:
    bench = Bench()
    with made(bench, curve="srgb") as projector:
        (shown,) = projector.load([Pattern("ramp", RAMP)])
        projector.show(0)
        drawn = bench.display.shown[-1][0][..., 0]
        light = 255.0 * srgb_light(drawn / 255.0)
        assert np.abs(light - RAMP).max() < 1.2
        assert np.abs(light - shown.image).max() <= 0.5 + 1e-9
        assert set(projector.caps.bit_depths) == {1, 8}


@pytest.mark.parametrize("bits", [1, 3, 7])
def test_fewer_bits_are_drawn_as_they_are_told(bits: int) -> None:
    bench = Bench()
    with made(bench) as projector:
        (shown,) = projector.load([Pattern("ramp", RAMP, bits)])
        projector.show(0)
        assert len(np.unique(bench.display.shown[-1][0])) == 2**bits
        np.testing.assert_array_equal(bench.display.shown[-1][0][..., 0], shown.image)


def test_other_colours_stay_dark() -> None:
    bench = Bench()
    with made(bench, channels=["green"]) as projector:
        projector.load([Pattern("ramp", RAMP)])
        projector.show(0)
        drawn = bench.display.shown[-1][0]
        np.testing.assert_array_equal(drawn[..., 1], RAMP)
        assert not drawn[..., [0, 2]].any()


def test_what_it_can_do_follows_from_the_display() -> None:
    with made(Bench(), lattice="diamond") as projector:
        caps = projector.caps
        assert (caps.size, caps.lattice, caps.trigger_outputs) == (SIZE, Lattice.DIAMOND, 0)
        assert caps.period_s == caps.bit_depths[8] == projector.refresh_s == 0.02
        info = projector.info()
        assert (info.model, info.link) == ("display 1 'HDMI-1'", "40 x 30, 50 Hz")
        projector.load([Pattern("ramp", RAMP)])
        with pytest.raises(CapabilityError, match="no trigger output"):
            projector.play(0.1)
    with made(Bench(), steady=True) as projector:
        assert projector.caps.period_s == 0.0
        assert projector.caps.lattice is Lattice.SQUARE


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"display": -1}, "'display'"),
        ({"curve": "rec709"}, "'curve'"),
        ({"size": [0, 1080]}, "'size"),
        ({"channels": []}, "'channels'"),
        ({"gamma": 2.2}, "gamma"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        DisplayProjector("projector", {"display": 0, **options}, None)


def test_a_flash_lasts_as_many_refreshes_as_asked() -> None:
    bench = Bench()
    with made(bench) as projector:
        with pytest.raises(SettingError, match="0 are loaded"):
            projector.flash(0, 3)
        projector.load([Pattern("ramp", RAMP)])
        for refreshes in (0, 601):
            with pytest.raises(SettingError, match="1 to 600"):
                projector.flash(0, refreshes)
        projector.flash(0, 3)
        assert bench.display.shown[-1][1] == 3
        assert projector.state is State.IDLE


def test_levels_on_an_x_servers_screen_are_those_of_the_pattern(monkeypatch: pytest.MonkeyPatch) -> None:
    """The root window's own pixels, and a display of another resolution than the projector's is refused."""
    with x_server((320, 200)) as server:
        server.use(monkeypatch)
        image = np.add.outer(np.arange(200), np.arange(320)).astype(np.uint8)
        with DisplayProjector("projector", {"display": 0, "curve": "srgb"}, None) as projector:
            (shown,) = projector.load([Pattern("ramp", image)])
            projector.show(0)
            np.testing.assert_array_equal(server.screen()[..., 1], pixel_table(True)[image])
            np.testing.assert_array_equal(light_table(True)[server.screen()[..., 0]], shown.image)
            projector.blank()
            assert not server.screen().any()
        wrong = DisplayProjector("projector", {"display": 0, "size": [1920, 1080]}, None)
        with pytest.raises(DeviceError, match=r"not set to 1920 x 1080; .* \(320 x 200\)"):
            wrong.open()
        wrong.close()
