"""What a real bench has beyond a world file, with strengths drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Falloff:
    """Light that is lost away from a centre: `1 - strength r² + slope · x`, x from -1 to 1 over the width.

    Attributes
    ----------
    strength : float
        Share that is lost at half the width from the centre.
    centre : tuple of float
        In units of half the width, from the middle.
    slope : tuple of float
        Change from the middle to the edge.
    """

    strength: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)
    slope: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class SecondLamp:
    """A lamp of the room, on the mains.

    Attributes
    ----------
    level : float
        Irradiance on a facing surface at 450 mm before the camera, relative to the projector's white.
    place_mm : tuple of float
        In the camera's frame.
    ripple : float
        Relative amplitude of its light at twice the mains' frequency.
    line_time_s : float
        From row to row of the camera, so that the ripple shows as bands.
    """

    level: float = 0.0
    place_mm: tuple[float, float, float] = (0.0, -900.0, -300.0)
    ripple: float = 0.0
    line_time_s: float = 0.0


@dataclass(frozen=True)
class Print:
    """What a printer makes of a board, fixed to it.

    Attributes
    ----------
    grain, mottle : float
        Relative standard deviations of the reflectance, fine and coarse.
    grain_mm, mottle_mm : float
        Standard deviations of the Gaussians that their white noise is smoothed by.
    gloss : float
        Peak of the highlight beside the light that the paper reflects.
    exponent : float
        Phong's, of the half vector.
    sag_mm, twist_mm : float
        Height of the middle above the corners, and of two corners above the others.
    """

    grain: float = 0.0
    mottle: float = 0.0
    grain_mm: float = 0.3
    mottle_mm: float = 8.0
    gloss: float = 0.0
    exponent: float = 40.0
    sag_mm: float = 0.0
    twist_mm: float = 0.0


@dataclass(frozen=True)
class Shaking:
    """Vibration of whatever the fixture holds.

    Attributes
    ----------
    mm : tuple of float
        Standard deviation along the camera's axes, all in step.
    hz : float
        Of its periodic part.
    periodic : float
        Share of the variance that is periodic; the rest is independent from frame to frame.
    """

    mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hz: float = 23.0
    periodic: float = 0.5


@dataclass(frozen=True)
class Effects:
    """All that a hidden bench has beyond its world.

    Attributes
    ----------
    seed : int
        Of noise-like fields and of every frame's draws.
    projector : Falloff
        Over the projector's image.
    camera : Falloff
        Over the camera's image, beside the vignetting of its world.
    fixed_pattern : float
        Relative standard deviation of the gain from pixel to pixel.
    flicker : float
        Relative standard deviation of the projector's light from frame to frame.
    lamp : SecondLamp
        Of the room.
    board : Print
        The board.
    shaking : Shaking
        Of what is mounted.
    """

    seed: int
    projector: Falloff = Falloff()
    camera: Falloff = Falloff()
    fixed_pattern: float = 0.0
    flicker: float = 0.0
    lamp: SecondLamp = SecondLamp()
    board: Print = Print()
    shaking: Shaking = Shaking()


def drawn_effects(seed: int) -> Effects:
    """Draw every effect.

    Parameters
    ----------
    seed : int
        Of the bench, not negative.

    Returns
    -------
    Effects
        None of them is absent.
    """
    random = np.random.default_rng([seed, 1])

    def between(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    def pair(most: float) -> tuple[float, float]:
        return between(-most, most), between(-most, most)

    direction = random.standard_normal(3)
    shaking = between(0.001, 0.008) * direction / np.linalg.norm(direction)
    return Effects(
        seed=seed,
        projector=Falloff(between(0.03, 0.2), pair(0.3), pair(0.04)),
        camera=Falloff(between(0.0, 0.08), pair(0.2), pair(0.02)),
        fixed_pattern=between(0.001, 0.006),
        flicker=between(0.0005, 0.004),
        lamp=SecondLamp(
            level=between(0.005, 0.05),
            place_mm=(between(-1200, 1200), between(-1200, 1200), between(-600, 200)),
            ripple=between(0.0, 0.15),
            line_time_s=float(random.choice([0.0, 2e-5])),
        ),
        board=Print(
            grain=between(0.005, 0.03),
            mottle=between(0.005, 0.02),
            grain_mm=between(0.15, 0.5),
            mottle_mm=between(4.0, 15.0),
            gloss=between(0.0, 0.15),
            exponent=between(10.0, 80.0),
            sag_mm=between(-0.05, 0.05),
            twist_mm=between(-0.03, 0.03),
        ),
        shaking=Shaking(
            mm=(float(shaking[0]), float(shaking[1]), float(shaking[2])),
            hz=between(8.0, 60.0),
            periodic=between(0.0, 1.0),
        ),
    )
