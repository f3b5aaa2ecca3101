"""What a real bench has beyond a world file, with strengths drawn from a seed."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Falloff:
    """Light that is lost away from a centre: `1 - strength r² + slope · x`, x from -1 to 1 over the width."""

    strength: float = 0.0  # share that is lost at half the width from the centre
    centre: tuple[float, float] = (0.0, 0.0)  # in units of half the width, from the middle
    slope: tuple[float, float] = (0.0, 0.0)  # change from the middle to the edge


@dataclass(frozen=True)
class SecondLamp:
    """A lamp of the room, on the mains."""

    level: float = 0.0  # irradiance on a facing surface at 450 mm before the camera
    place_mm: tuple[float, float, float] = (0.0, -900.0, -300.0)  # in the camera's frame
    ripple: float = 0.0  # relative amplitude of its light at twice the mains' frequency
    line_time_s: float = 0.0  # from row to row of the camera, so that the ripple shows as bands


@dataclass(frozen=True)
class Print:
    """What a printer makes of a board, fixed to it."""

    grain: float = 0.0  # relative standard deviations of the reflectance, fine and coarse
    mottle: float = 0.0  # relative standard deviations of the reflectance, fine and coarse
    grain_mm: float = 0.3  # standard deviations of the Gaussians that their white noise is smoothed by
    mottle_mm: float = 8.0  # standard deviations of the Gaussians that their white noise is smoothed by
    gloss: float = 0.0  # peak of the highlight beside the light that the paper reflects
    exponent: float = 40.0  # phong's, of the half vector
    sag_mm: float = 0.0  # height of the middle above the corners, and of two corners above the others
    twist_mm: float = 0.0  # height of the middle above the corners, and of two corners above the others


@dataclass(frozen=True)
class Shaking:
    """Vibration of whatever the fixture holds."""

    mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # standard deviation along the camera's axes
    hz: float = 23.0  # of its periodic part
    periodic: float = 0.5  # share of the variance that is periodic


@dataclass(frozen=True)
class Effects:
    """All that a hidden bench has beyond its world."""

    seed: int  # of noise-like fields and of every frame's draws
    projector: Falloff = Falloff()  # over the projector's image
    camera: Falloff = Falloff()  # over the camera's image, beside the vignetting of its world
    fixed_pattern: float = 0.0  # relative standard deviation of the gain from pixel to pixel
    flicker: float = 0.0  # relative standard deviation of the projector's light from frame to frame
    lamp: SecondLamp = SecondLamp()  # of the room
    board: Print = Print()  # the board
    shaking: Shaking = Shaking()  # of what is mounted


def drawn_effects(seed: int) -> Effects:
    """Draw every effect."""
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
