"""The optics of an emulated bench: another rig, which projects patterns and captures images of them."""

import hashlib
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings, Projector
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern

GreyImage = NDArray[np.uint8]  # grey levels, uint8 (height, width)
MAX_LOADED_PATTERNS = 128
"""Patterns that the projector is given at once (chosen: 133 MB of a LightCrafter's size)."""


class OpticsRig:
    """A rig in place of light, lens and sensor, used as any program would use it."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._patterns = PatternCache(rig.projector)
        self._settings: CameraSettings | None = None
        self._stage_mm = 0.0

    @property
    def size(self) -> tuple[int, int]:
        """Size of the images, (width, height) in px."""
        return self._rig.camera.caps.size

    def move_stage(self, stage_mm: float) -> None:
        """Move the rig's stage, if it has one; it is homed before its first move."""
        stage = self._rig.stage
        if stage is None or stage_mm == self._stage_mm:
            return
        if self._stage_mm == 0.0:
            stage.home()
        stage.move_to(stage_mm)
        self._stage_mm = stage_mm

    def capture(
        self, settings: CameraSettings, greys: GreyImage | None, others: Callable[[], Iterable[GreyImage]]
    ) -> Image:
        # greys (height, width)
        camera = self._rig.camera
        bits = max(bits for bits in camera.caps.bits if bits <= settings.bits)
        requested = CameraSettings(settings.exposure_s, settings.gain_db, bits)
        if requested != self._settings:
            self._settings = None
            camera.configure(requested)
            self._settings = requested
        if greys is None:
            self._rig.projector.blank()
        else:
            self._patterns.show(greys, others)
        image = camera.snap(settings.exposure_s + 60.0).image  # rendering takes time
        if bits == settings.bits:
            return image
        return np.left_shift(image.astype(np.uint16), settings.bits - bits, dtype=np.uint16)


class PatternCache:
    """The patterns that a projector holds, recognised by content, so that none is loaded twice."""

    def __init__(self, projector: Projector) -> None:
        self._projector, self._size = projector, projector.caps.size
        self._capacity = min(MAX_LOADED_PATTERNS, projector.caps.max_patterns)
        self._loaded: dict[bytes, Pattern] = {}
        self._indices: dict[bytes, int] = {}

    def show(self, greys: GreyImage, others: Callable[[], Iterable[GreyImage]]) -> None:
        # greys (height, width)
        fitted = self._resampled(greys)
        key = _key(fitted)
        if key not in self._indices:
            images = {_key(image): image for image in map(self._resampled, others())} | {key: fitted}
            self._load(images if len(images) <= self._capacity else {key: fitted})
        self._projector.show(self._indices[key])

    def _load(self, images: dict[bytes, GreyImage]) -> None:
        self._loaded = {
            key: self._loaded.get(key) or _pattern_of_image(key, image) for key, image in images.items()
        }
        self._indices = {}
        self._projector.load(list(self._loaded.values()))
        self._indices = {key: index for index, key in enumerate(self._loaded)}

    def _resampled(self, greys: GreyImage) -> GreyImage:
        (height, width), (columns, rows) = greys.shape, self._size
        if (width, height) == self._size:
            return greys
        places = np.ix_(np.arange(rows) * height // rows, np.arange(columns) * width // columns)
        return np.asarray(greys[places], np.uint8)


def _key(image: GreyImage) -> bytes:
    return hashlib.blake2b(image.tobytes(), digest_size=16).digest()


def _pattern_of_image(key: bytes, image: GreyImage) -> Pattern:
    read_only = image.copy()
    read_only.flags.writeable = False
    return Pattern(key.hex(), read_only)
