"""What neither twins nor the drawn effects have: one such effect for a bench, drawn from a seed."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from fpplab.core.conventions import Floats
from sim.light import PatternLevels
from sim.world import World

KINDS = ("drift", "astigmatism", "dust", "bent_field", "warm")
SESSION_FRAMES, POSES_FRAMES = 200.0, 200.0
"""Frames after which what drifts, or what changes from recording to recording, is 63 % of its way."""
SPECKS = 8
TAPER_PX = 3.0  # reach of the camera's point spread in its standard deviations


@dataclass(frozen=True)
class Foreign:
    """One effect, or none, of a bench."""

    seed: int = 0  # of the specks
    picture_px: tuple[float, float] = (0.0, 0.0)  # way of the projector's picture, in columns and rows
    dimming: float = 0.0  # share of its light that it loses meanwhile
    zoom: float = 0.0  # relative change of the projector's focal lengths from recording to recording
    pointing_deg: tuple[float, float] = (0.0, 0.0)  # turn of the projector likewise
    camera_px: float = 0.0  # standard deviation of the camera's further point spread, along one direction
    camera_deg: float = 0.0  # of that direction to the rows
    projector_px: tuple[float, float] = (0.0, 0.0)  # of the projector's, in columns and rows
    speck: float = 0.0  # greatest share of light that a speck of dust takes, on both lenses
    bend: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the response: by column, row and squared distance

    def passed(self, frame: float) -> float:
        """Give the share of its way that drift has gone at a frame."""
        return float(1.0 - np.exp(-frame / SESSION_FRAMES))

    def span(self, first: int, count: int) -> tuple[float, float]:
        """Give the shares at the first and the last frame of a recording."""
        early = self.passed(first)
        return early, self.passed(first + count - 1) if any(self.picture_px) else early

    def world(self, world: World, share: float) -> World:
        """Change a world as far as the share of the way says."""
        projector = world.projector
        held = projector.T_camera_projector
        turned = [a + share * b for a, b in zip(held.rotation_deg, (*self.pointing_deg, 0.0), strict=True)]
        changes = {
            "throw_ratio": projector.throw_ratio * (1.0 + self.zoom * share),
            "centre_px": tuple(
                a + share * b for a, b in zip(projector.centre_px, self.picture_px, strict=True)
            ),
            "T_camera_projector": held.model_copy(update={"rotation_deg": tuple(turned)}),
        }
        return world.model_copy(update={"projector": projector.model_copy(update=changes)})

    def mirrors(self, light: PatternLevels, brightest: float) -> PatternLevels:
        """Change the light (rows, columns) of the projector's mirrors."""
        if not (any(self.bend) or any(self.projector_px) or self.speck):
            return light
        rows, columns = light.shape
        y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
        change = light + (self.bend[0] * x + self.bend[1] * y + self.bend[2] * (x**2 + y**2 - 2 / 3)) * (
            light * (1.0 - light / brightest)
        )
        if self.speck:
            change *= self.specks(columns, rows, 0)
        spread = np.asarray(change, np.float32)
        for axis, sigma in enumerate(self.projector_px):
            if sigma:
                kernel = cv2.getGaussianKernel(2 * int(np.ceil(4 * sigma)) + 1, sigma)
                pair = (kernel, np.ones(1)) if axis == 0 else (np.ones(1), kernel)
                spread = np.asarray(cv2.sepFilter2D(spread, -1, *pair), np.float32)
        return spread

    def seen(self, picture: PatternLevels) -> PatternLevels:
        """Spread light (height, width) as the camera's lens does."""
        if not self.camera_px:
            return picture
        reach = int(np.ceil(TAPER_PX * self.camera_px)) + 1
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        angle = np.radians(self.camera_deg)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        # across the direction only as much as keeps the kernel smooth over pixels
        kernel = np.exp(-0.5 * ((along / self.camera_px) ** 2 + (across / 0.25) ** 2))
        return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum()), np.float32)

    def specks(self, width: int, height: int, device: int) -> Floats:
        """Compute what dust leaves of the light (height, width) of projector, 0, or camera, 1."""
        return 1.0 - self.speck * _dust(self.seed, width, height, device)


@cache
def _dust(seed: int, width: int, height: int, device: int) -> Floats:
    """What dust takes of the light (height, width), 1 at most but where specks meet."""
    random = np.random.default_rng([seed, 6, device])
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    taken = np.zeros((height, width))
    for _ in range(SPECKS):
        at, size = random.uniform(0, 1, 2) * (width, height), width * random.uniform(0.004, 0.012)
        square = (x - at[0]) ** 2 + (y - at[1]) ** 2
        taken += random.uniform(0.25, 1.0) * np.exp(-0.5 * square / size**2)
    return taken


def drawn_foreign(kind: str, seed: int) -> Foreign:
    """Draw one of `KINDS`."""
    random = np.random.default_rng([seed, 5])

    def between(low: float, high: float) -> float:
        return float(random.uniform(low, high) * random.choice([-1.0, 1.0]))

    if kind == "drift":
        return Foreign(seed, (between(0.2, 0.6), between(0.2, 0.6)), abs(between(0.02, 0.06)))
    if kind == "astigmatism":
        wide = abs(between(0.4, 0.8))
        projector = (wide, 0.0) if random.random() < 0.5 else (0.0, 2 * wide)  # a column is two rows wide
        return Foreign(
            seed,
            camera_px=abs(between(0.4, 0.8)),
            camera_deg=abs(between(0.0, 180.0)),
            projector_px=projector,
        )
    if kind == "dust":
        return Foreign(seed, speck=abs(between(0.04, 0.1)))
    if kind == "bent_field":
        return Foreign(seed, bend=(between(0.03, 0.06), between(0.03, 0.06), between(0.02, 0.05)))
    return Foreign(seed, zoom=between(2e-4, 8e-4), pointing_deg=(between(0.01, 0.03), between(0.01, 0.03)))
