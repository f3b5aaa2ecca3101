"""A twin of a flat board by formulas: rays, a plane, two look-ups. What Blender does for the real one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fpplab import artefacts
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats, Image, Lattice, Map, PixelIndices, full_scale
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.mosaic import Bayer, colour_factors
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.sessions.session import Session
from fpplab.targets import Target
from sim.appearance import Appearance
from sim.parameters import TwinParameters
from sim.twin import ExpectedLevels, FrameCounter

CAMERA = Pinhole.from_focal((456, 304), (1216, 1216), (230, 150), (-0.08, 0.1, 4e-4, -3e-4, 0))
PROJECTOR = Pinhole.from_focal((456, 285), (547, 547), (227, 300), (-0.03, 0.05, 2e-4, 3e-4, 0))
PAIR = RigidTransform.from_vectors(np.radians([-15, -18.1, 2.2]), np.array([150.0, 0, 0])).inverse()
TARGET = config.validate(
    {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
     "staggered": True, "diameter_mm": 3, "foreground": 0.05, "background": 0.9},
    Target, "board.yaml",
)  # fmt: skip
SETTINGS = CameraSettings(0.02, 0.0, 8)
PX_PER_MM = 12.0
CARD = RigidTransform(np.eye(3), np.array([0, 0, 450.0]))


def tilted(count: int, seed: int = 0) -> tuple[RigidTransform, ...]:
    """Poses that both devices see whole."""
    random = np.random.default_rng(seed)
    tilts = np.radians(random.uniform(-25, 25, (count, 3)) * [1, 1, 0.3])
    places = random.uniform((-14, -8, 430), (14, 8, 470), (count, 3))
    return tuple(RigidTransform.from_vectors(t, p) for t, p in zip(tilts, places, strict=True))


def nominal(poses: Sequence[RigidTransform]) -> TwinParameters:
    return TwinParameters(
        calibration=Calibration(CAMERA, PROJECTOR, PAIR, {}),
        poses=tuple(poses),
        white=1.0,
        response=Curve(a=0.98, b=0.02, g=1.0),
        ambient=0.01,
        paper=TARGET.background,
        ink=TARGET.foreground,
        projector_blur=0.6,
        projector_focus_mm=None,
        projector_aperture_mm=10.0,
        camera_focus_mm=None,
        f_number=2.8,
        vignetting=0.0,
        black_level=0.01,
        read_noise_e=2.5,
        full_well_e=15000.0,
        vibration_mm=0.0,
    )


def look_up(u: Floats, v: Floats, size: tuple[int, int]) -> csr_array:
    """Bilinear look-up of pictures of `size` (columns, rows) as a matrix, a row per pixel; 0 outside."""
    columns, rows = size
    u, v = u.ravel(), v.ravel()
    inside = np.flatnonzero((u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1))
    left = np.minimum(u[inside].astype(int), columns - 2)
    top = np.minimum(v[inside].astype(int), rows - 2)
    right, below = u[inside] - left, v[inside] - top
    first = top * columns + left
    corners = np.stack([first, first + 1, first + columns, first + columns + 1], axis=-1)
    weights = np.stack(
        [(1 - right) * (1 - below), right * (1 - below), (1 - right) * below, right * below], axis=-1
    )
    per_pixel = np.zeros(u.size + 1, int)
    per_pixel[inside + 1] = 4
    entries = (weights.ravel().astype(np.float32), corners.ravel(), np.cumsum(per_pixel))
    return csr_array(entries, shape=(u.size, columns * rows))


@cache
def printed() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Shares of ink and of board, with a rim of what is not board: nothing comes back from there."""
    grey = (TARGET.image(PX_PER_MM) / 255.0 - TARGET.background) / (TARGET.foreground - TARGET.background)
    ink, there = (np.pad(share, 20).astype(np.float32) for share in (grey, np.ones_like(grey)))
    return cv2.GaussianBlur(ink, (0, 0), 2.0), cv2.GaussianBlur(there, (0, 0), 2.0)


@cache
def squared_slopes() -> Floats:
    """Of the camera's pixels' rays against its axis, (h, w)."""
    u, v = np.meshgrid(np.arange(CAMERA.size[0]), np.arange(CAMERA.size[1]))
    return ((u - 230) / 1216) ** 2 + ((v - 150) / 1216) ** 2


@cache
def falloff_terms() -> Floats:
    """What the coefficients of the projector's falloff multiply, (5, rows, columns)."""
    columns, rows = PROJECTOR.size
    x = (np.arange(columns) - 0.5 * (columns - 1)) / (0.5 * columns)
    y = ((np.arange(rows) - 0.5 * (rows - 1)) / (0.5 * columns))[:, None]
    return np.stack([x + 0 * y, y + 0 * x, x**2 + 0 * y, x * y, y**2 + 0 * x])


@dataclass(frozen=True, eq=False)
class SeenSample:
    """What one of the two samples of every pixel sees, (h, w), at one pose."""

    ink: NDArray[np.float32]
    """Share of ink."""
    there: NDArray[np.float32]
    """Share of board."""
    projector: csr_array
    """The projected picture's look-up."""
    irradiance: NDArray[np.float32]
    """Of a projector that is even."""


class PlaneTwin:
    """Does what `sim.twin.Twin` does."""

    def __init__(
        self,
        parameters: TwinParameters,
        seed: int = 0,
        bend_mm: Callable[[Floats, Floats], Floats] | None = None,
        by_exposure: bool = False,
    ) -> None:
        self._now, self._bend_mm = parameters, bend_mm
        self._seed, self._counter = seed, FrameCounter()
        self._before_images: Callable[[], object] = lambda: None
        self._kept: dict[bytes, list[SeenSample]] = {}
        self._shares: Map | None = None
        self._by_exposure = by_exposure  # whether levels follow the exposure

    @property
    def parameters(self) -> TwinParameters:
        return self._now

    @property
    def target(self) -> Target:
        return TARGET

    @property
    def next_frame(self) -> int:
        return self._counter.next_frame

    def count_frames_from(self, number: int) -> None:
        self._counter.next_frame = number

    def with_parameters(self, parameters: TwinParameters) -> Self:
        other = copy(self)
        other._now = parameters
        return other

    def with_filter(self, bayer: Bayer | None, white: tuple[float, float, float] | None) -> Self:
        other = copy(self)
        other._shares = None
        if bayer is not None and white is not None:
            red, green, blue = (share / max(white) for share in white)
            other._shares = colour_factors(CAMERA.size[::-1], bayer, (red, green, blue))
        return other

    def with_progress(self, before_images: Callable[[], object]) -> Self:
        other = copy(self)
        other._before_images = before_images
        return other

    def with_appearance(self, appearance: Appearance) -> Self:
        """Nothing is seen beside the board, and its print is even."""
        return self

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        self._before_images()
        return self._seen(self._now.poses[pose], patterns, settings, board=True)

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        self._before_images()
        return self._seen(self._now.poses[pose], patterns, settings, board=True)[:, *pixels]

    def expected_with_slopes(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> None:
        self._before_images()

    def expected_of(self, item: str, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        return self._seen(self.pose_of(item), patterns, settings, board=False)

    def expected_of_greys(
        self, item: str, greys: Floats, settings: CameraSettings
    ) -> Iterator[NDArray[np.float32]]:
        levels = np.rint(255 * greys).astype(int).tolist()
        yield from self.expected_of(
            item, uniform_patterns(levels, self._now.calibration.projector.size), settings
        )

    def expected_part(
        self,
        item: str,
        pose: RigidTransform,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        pixels: PixelIndices,
    ) -> ExpectedLevels:
        self._before_images()
        return self._seen(pose, patterns, settings, board=False)[:, *pixels]

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        self._before_images()
        now = self._now
        expected = self._seen(now.poses[pose], patterns, settings, board=True)
        random = self._draws(len(patterns))
        if now.projector_flicker or now.ambient_ripple:
            expected = self._changing(pose, patterns, settings, expected, random)
        if now.displacement_mm:
            expected = expected + self._shaken(pose, patterns, settings, expected, random)
        return self._digitised(expected, settings, random)

    def _changing(
        self,
        pose: int,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        expected: ExpectedLevels,
        random: np.random.Generator,
    ) -> NDArray[np.float32]:
        now = self._now
        no_lamp, dark = (
            self.with_parameters(replace(now, lamp_irradiance=0.0, **ambient))._seen(
                now.poses[pose], patterns, settings, board=True
            )
            for ambient in ({}, {"ambient": 0.0})
        )
        black, (count, rows, _) = np.float32(full_scale(settings.bits) * now.black_level), expected.shape
        factor = 1 + now.projector_flicker * random.standard_normal((count, 1, 1))
        starts = random.random((count, 1, 1))
        if now.band_advance is not None:
            starts = starts[:1] + now.band_advance * np.arange(count)[:, None, None]
        phase = np.arange(rows)[:, None] / (now.band_period_px or 1.0) + starts
        wave = now.ambient_ripple * np.sin(2 * np.pi * phase)
        even, lamps = 1 + now.even_light_rippling * wave, 1 + now.lamp_light_rippling * wave
        changed = black + factor * (dark - black) + even * (no_lamp - dark) + lamps * (expected - no_lamp)
        return changed.astype(np.float32)

    def _draws(self, frames: int) -> np.random.Generator:
        """The noise of the next frames follows from their number."""
        self._counter.take(frames)
        return np.random.default_rng([self._seed, self._counter.next_frame])

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        seen = self._seen(pose, patterns, settings, board=False)
        return self._digitised(seen, settings, self._draws(len(patterns)))

    def mesh(self, item: str) -> trimesh.Trimesh:
        return artefacts.make(item)

    def pose_of(self, item: str) -> RigidTransform:
        return self._now.placed.get(item, CARD)

    def save(self, folder: Path, notes: Sequence[str] = (), settings: CameraSettings = SETTINGS) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        self._now.calibration.save(folder / "calibration.yaml")
        return folder / "rig.yaml"

    def slopes_per_mm(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, expected: ExpectedLevels
    ) -> NDArray[np.float32]:
        """Change of the expected levels as the board moves along each axis, (3, n, h, w)."""
        place, step = self._now.poses[pose], 0.02
        moved = (RigidTransform(place.rotation, place.translation + step * axis) for axis in np.eye(3))
        seen = (self._seen(there, patterns, settings, board=True) for there in moved)
        return np.stack([(one - expected) / step for one in seen])

    def _shaken(
        self,
        pose: int,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        expected: ExpectedLevels,
        random: np.random.Generator,
    ) -> NDArray[np.float32]:
        now = self._now
        shake = random.normal(0, now.vibration_mm, (len(patterns), 3))
        turn = 2 * np.pi * (now.vibration_cycles_per_frame * np.arange(len(patterns)) + random.random())
        along = np.sqrt(2 * now.vibration_periodic) * np.sin(turn)
        along += np.sqrt(1 - now.vibration_periodic) * random.standard_normal(len(patterns))
        shake += np.outer(along, now.vibration_line_mm)
        return np.einsum(
            "na,anvu->nvu", shake.astype(np.float32), self.slopes_per_mm(pose, patterns, settings, expected)
        )

    def _digitised(
        self, expected: ExpectedLevels, settings: CameraSettings, random: np.random.Generator
    ) -> list[Image]:
        now, full = self._now, full_scale(settings.bits)
        per_electron = full * (1 - now.black_level) / (16 * now.full_well_e)
        signal = np.maximum(expected - full * now.black_level, 0)
        sigma = np.sqrt(per_electron * signal + (4 * per_electron * now.read_noise_e) ** 2)
        noisy = expected + sigma * random.standard_normal(expected.shape)
        return list(np.rint(noisy).clip(0, full).astype(np.uint8))

    def _seen(
        self, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings, board: bool
    ) -> ExpectedLevels:
        now, full = self._now, full_scale(settings.bits)
        width, height = now.calibration.camera.size
        out = np.zeros((len(patterns), height, width), np.float32)
        blur = self._blur_px(pose.translation[2], now.projector_focus_mm, now.projector_aperture_mm, 1300.0)
        sigma = float(np.hypot(now.projector_blur, blur))
        room = now.ambient + self._lamp(pose)
        samples, falloff = self._samples(pose), self._falloff()
        albedos = [self._albedo(sample, board) for sample in samples]
        for n, pattern in enumerate(patterns):
            light = (now.response.apply(pattern.image / 255.0) * falloff).astype(np.float32)
            light = cv2.GaussianBlur(light, (0, 0), sigma).ravel()
            for sample, albedo in zip(samples, albedos, strict=True):
                lit = (sample.projector @ light).reshape(height, width)
                out[n] += 0.5 * albedo * (lit * sample.irradiance + room)
        sharp = self._blur_px(
            pose.translation[2], now.camera_focus_mm, 35.0 / now.f_number, CAMERA.matrix[0, 0]
        )
        for n in range(len(out)):
            if sharp > 0.01:
                out[n] = cv2.GaussianBlur(out[n], (0, 0), sharp)
        vignetting = (1 + squared_slopes()) ** (-now.vignetting / 2)
        light = 0.8 * now.white * out * vignetting
        if self._by_exposure:
            light = light * np.float32(settings.exposure_s / SETTINGS.exposure_s)
        if self._shares is not None:
            light = light * self._shares
        levels = full * (now.black_level + (1 - now.black_level) * light)
        return np.asarray(levels.clip(0, full), np.float32)

    def _albedo(self, sample: SeenSample, board: bool) -> NDArray[np.float32]:
        now = self._now
        if board:
            seen = now.paper * (sample.there - sample.ink) + now.ink * sample.ink
            return np.asarray(seen, np.float32)
        return np.full_like(sample.ink, 0.9)

    def _lamp(self, pose: RigidTransform) -> NDArray[np.float32]:
        """Light of the room's lamp on what every pixel sees, (h, w); its place is given from `CARD`."""
        now = self._now
        if now.lamp_irradiance == 0:
            return np.zeros(now.calibration.camera.size[::-1], np.float32)
        angle, azimuth = np.radians([now.lamp_angle_deg, now.lamp_azimuth_deg])
        towards = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), -np.cos(angle)])
        rays, normal = _rays(now.calibration.camera, 0.0, 0.0), pose.rotation[:, 2]
        points = rays * ((normal @ pose.translation) / (rays @ normal))[..., None]
        ways = CARD.translation + now.lamp_distance_mm * towards - points
        away = np.linalg.norm(ways, axis=-1)
        cosine = np.maximum(ways @ normal * -np.sign(normal @ pose.translation) / away, 0.0)
        light = now.lamp_irradiance * (now.lamp_distance_mm / away) ** 2 * cosine
        return np.asarray(light, np.float32)

    def _falloff(self) -> Floats:
        return np.asarray(1.0 + np.tensordot(self._now.projector_falloff, falloff_terms(), axes=1))

    def _blur_px(self, z: float, focus: float | None, aperture: float, focal_px: float) -> float:
        return 0.0 if focus is None else float(0.25 * aperture * abs(1 / z - 1 / focus) * focal_px)

    def _samples(self, pose: RigidTransform) -> list[SeenSample]:
        now = self._now.calibration
        key = np.concatenate(
            [pose.matrix.ravel(), now.camera.matrix.ravel(), now.camera.distortion,
             now.projector.matrix.ravel(),
             now.projector.distortion, now.T_projector_camera.matrix.ravel()]
        ).tobytes()  # fmt: skip
        if key not in self._kept:
            if len(self._kept) > 40:
                self._kept.clear()
            self._kept[key] = [self._sample(pose, du, dv) for du, dv in ((-0.25, -0.25), (0.25, 0.25))]
        return self._kept[key]

    def _sample(self, pose: RigidTransform, du: float, dv: float) -> SeenSample:
        now = self._now.calibration
        rays = _rays(now.camera, du, dv)
        normal = pose.rotation[:, 2]
        points = rays * ((normal @ pose.translation) / (rays @ normal))[..., None]
        on_board = pose.inverse().apply(points)
        if self._bend_mm is not None:  # the bend is so shallow that one step along the ray leads there
            points = (
                points * (1 + self._bend_mm(*on_board[..., :2].T).T / (normal @ pose.translation))[..., None]
            )
            on_board = pose.inverse().apply(points)
        at = now.T_projector_camera.apply(points)
        pixel = now.projector.project(at)
        distance = np.linalg.norm(at, axis=-1)
        cosine = np.abs((points - now.projector_centre) @ normal) / distance
        column = (on_board[..., 0] + 0.5 * TARGET.size_mm[0]) * PX_PER_MM + 19.5
        row = (on_board[..., 1] + 0.5 * TARGET.size_mm[1]) * PX_PER_MM + 19.5
        ink, there = printed()
        board = look_up(column, row, ink.shape[::-1])
        return SeenSample(
            ink=(board @ ink.ravel()).reshape(column.shape),
            there=(board @ there.ravel()).reshape(column.shape),
            projector=look_up(pixel[..., 0], pixel[..., 1], PROJECTOR.size),
            irradiance=(cosine * (475 / distance) ** 2).astype(np.float32),
        )


_known_rays: dict[bytes, Floats] = {}


def _rays(camera: Pinhole, du: float, dv: float) -> Floats:
    """Of every pixel, (h, w, 3), kept from before for the same camera."""
    key = np.concatenate([camera.matrix.ravel(), camera.distortion, [du, dv]]).tobytes()
    if key not in _known_rays:
        width, height = camera.size
        u, v = np.meshgrid(np.arange(width) + du, np.arange(height) + dv)
        slopes = camera.normalise(np.stack([u, v], axis=-1))
        _known_rays[key] = np.concatenate([slopes, np.ones((height, width, 1))], axis=-1)
    return _known_rays[key]


def moved(parameters: TwinParameters, mm: float, degrees: float, seed: int = 0) -> TwinParameters:
    """With every pose of the board off by so much, each in another direction."""
    random = np.random.default_rng(seed)

    def off(pose: RigidTransform) -> RigidTransform:
        turn, shift = random.standard_normal((2, 3))
        turn *= np.radians(degrees) / np.linalg.norm(turn)
        shift *= mm / np.linalg.norm(shift)
        turned = RigidTransform.from_vectors(turn, np.zeros(3)).rotation @ pose.rotation
        return RigidTransform(turned, pose.translation + shift)

    return replace(parameters, poses=tuple(off(pose) for pose in parameters.poses))


def record(twin: PlaneTwin, plan: Plan, folder: Path, bayer: Bayer | None = None) -> list[Session]:
    """Every pose of a twin as a session, as a bench would leave it."""
    size = twin.parameters.calibration.projector.size
    rig: dict[str, Any] = {"resolved": {"projector": {"size": list(size), "lattice": "square"}}}
    if bayer:
        rig["resolved"]["camera"] = {"bayer": bayer}
    patterns = make_patterns(plan, size, Lattice.SQUARE)
    sessions = []
    for pose in range(len(twin.parameters.poses)):
        session = Session.create(folder / f"pose_{pose:02d}", plan, rig)
        index = 0
        for exposure_s, images in zip(plan.exposures, plan.passes, strict=True):
            shown, settings = [patterns[i] for i in images], replace(SETTINGS, exposure_s=exposure_s)
            for pattern, image in zip(shown, twin.frames(pose, shown, settings), strict=True):
                session.write(Frame(image, index, settings, 0.0, pattern_id=pattern.id))
                index += 1
        sessions.append(session)
    return sessions


@dataclass(frozen=True, eq=False)
class Remembered:
    """A session without a disk: what `sim.matching` asks of one."""

    plan: Plan
    images: list[Image]
    path: Path

    @classmethod
    def of(cls, twin: PlaneTwin, plan: Plan, pose: int) -> Remembered:
        patterns = make_patterns(plan, PROJECTOR.size, Lattice.SQUARE)
        return cls(plan, twin.frames(pose, patterns, SETTINGS), Path(f"pose_{pose:02d}"))

    @property
    def records(self) -> list[Any]:
        return [SimpleNamespace(settings=SETTINGS) for _ in self.images]

    @property
    def bayer(self) -> None:
        return None

    @property
    def format(self) -> tuple[int, int, int]:
        return (*CAMERA.size, SETTINGS.bits)

    def read(self, index: int, verify: bool = True) -> Image:
        return self.images[index]

    def recording(self, verify: bool = True) -> Recording:
        return Recording(self.images, self.plan, PROJECTOR.size, SETTINGS.bits, str(self.path))

    def projector(self) -> tuple[tuple[int, int], Lattice]:
        return PROJECTOR.size, Lattice.SQUARE
