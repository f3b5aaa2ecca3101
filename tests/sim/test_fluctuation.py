"""Flicker and rolling bands of a world, in frames and in what predictions are made of."""

import numpy as np
import pytest

from fpplab.core.errors import ConfigError
from sim.fluctuation import Fluctuation
from sim.light import PatternLevels
from tests.sim.conftest import world

AMBIENT, FLICKER, RIPPLE, PERIOD = 0.2, 0.02, 0.4, 24.0
NO_LAMP = np.float32(0.0)


def test_steady_light_is_left_alone() -> None:
    assert Fluctuation.of(world()) is None


def test_a_frame_has_its_own_factor_and_its_own_bands() -> None:
    bands = {"ripple": RIPPLE, "period_px": PERIOD}
    of = world(seed=3, projector={"flicker": FLICKER}, ambient_bands=bands, ambient=AMBIENT)
    changes = Fluctuation(of, ())
    ambient, rows = np.full((480, 4), AMBIENT, np.float32), np.arange(480)
    frames = np.stack([changes.applied(ambient + 0.5, ambient, NO_LAMP, rows, n) for n in range(200)])
    whole = frames.mean(axis=(1, 2)) - AMBIENT  # 480 rows are 20 whole periods
    assert whole.mean() == pytest.approx(0.5, rel=0.005)
    assert whole.std() == pytest.approx(0.5 * FLICKER, rel=0.15)
    waves = np.fft.rfft(frames[:, :, 0], axis=1) / 240
    assert np.abs(waves[:, 20]) == pytest.approx(RIPPLE * AMBIENT, rel=1e-3)
    assert np.abs(np.exp(1j * np.angle(waves[:, 20])).mean()) < 0.2
    some = changes.applied((ambient + 0.5)[100:110], ambient[100:110], NO_LAMP, rows[100:110], 7)
    np.testing.assert_array_equal(some, frames[7, 100:110])


def test_bands_may_move_on_evenly() -> None:
    bands = {"ripple": RIPPLE, "period_px": PERIOD, "cycles_per_frame": 0.15}
    changes = Fluctuation(world(ambient_bands=bands, ambient=AMBIENT), (5,))
    others = Fluctuation(world(ambient_bands=bands, ambient=AMBIENT), (6,))
    ambient, rows = np.full((48, 4), AMBIENT, np.float32), np.arange(48)
    start = phase_of_bands(changes.applied(ambient, ambient, NO_LAMP, rows, 0))
    assert start != pytest.approx(
        phase_of_bands(others.applied(ambient, ambient, NO_LAMP, rows, 0)), abs=1e-3
    )
    for n in range(5):
        seen = changes.applied(ambient, ambient, NO_LAMP, rows, n)[:, 0]
        expected = AMBIENT * (1 + RIPPLE * np.sin(2 * np.pi * (rows / PERIOD + start + 0.15 * n)))
        np.testing.assert_allclose(seen, expected, rtol=1e-5)


@pytest.mark.parametrize(("even", "lamps"), [(0.0, 1.0), (1.0, 0.0), (0.5, 1.0)])
def test_one_light_of_the_room_may_ripple_more_than_the_other(even: float, lamps: float) -> None:
    bands = {"ripple": RIPPLE, "period_px": PERIOD, "even_light_share": even, "lamp_light_share": lamps}
    changes = Fluctuation(world(ambient_bands=bands, ambient=AMBIENT), ())
    room, rows = np.full((48, 4), AMBIENT, np.float32), np.arange(48)
    lamp_share = np.array([[0.0, 0.2, 0.6, 1.0]], np.float32)
    seen = changes.applied(room, room, lamp_share, rows, 0)
    size = np.abs(np.fft.rfft(seen, axis=0)[round(48 / PERIOD)]) / 24
    expected = RIPPLE * AMBIENT * (even * (1 - lamp_share[0]) + lamps * lamp_share[0])
    np.testing.assert_allclose(size, expected, rtol=1e-3, atol=1e-6)


def phase_of_bands(frame: PatternLevels) -> float:
    """Where the bands of a frame (48, n) begin, in periods."""
    wave = np.fft.rfft(frame[:, 0].astype(np.float64))[round(48 / PERIOD)]
    return float(np.angle(1j * wave) / (2 * np.pi))


def test_bands_need_ambient_light_and_are_scaled_with_the_binning() -> None:
    bands = {"ripple": RIPPLE, "period_px": PERIOD}
    assert Fluctuation.of(world(ambient_bands=bands)) is None
    lit = world(ambient_bands=bands, ambient=AMBIENT)
    ambient, rows = np.full((48, 4), AMBIENT, np.float32), np.arange(48)
    for binning in (1, 2):
        found = Fluctuation.of(lit.binned(binning))
        assert found is not None
        waves = np.abs(np.fft.rfft(found.applied(ambient, ambient, NO_LAMP, rows, 0)[:, 0])[1:])
        assert np.argmax(waves) + 1 == round(48 * binning / PERIOD)


def test_impossible_bands_are_refused() -> None:
    with pytest.raises(ConfigError, match="ripple"):
        world(ambient_bands={"ripple": 1.5, "period_px": PERIOD}, ambient=AMBIENT)
