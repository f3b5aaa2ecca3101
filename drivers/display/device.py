"""A projector with a display input as a projector of a rig: a second screen of the computer, shown 1:1."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from drivers.display.window import SdlDisplay
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats, Lattice
from fpplab.devices import DeviceInfo, FlashingProjector, ProjectorCaps
from fpplab.patterns.fringes import Pattern, quantise

Channel = Literal["red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")  # of a pixel, in the order of a frame
MAX_PATTERNS = 1024  # patterns that are held at once, in the computer's memory (chosen)
CURVED_DEPTHS = (1, 8)  # bit depths whose grey levels a curve of 8 bits still shows

Side = Annotated[int, Field(ge=16, le=16384)]


class DisplayOptions(Document):
    """The projector's section in a rig file."""

    display: Annotated[int, Field(ge=0)] | str
    """Number or name of the computer's display."""
    size: tuple[Side, Side] | None = None
    """Width and height in px that the display must have: the projector's own resolution, so that a scaled
    picture is refused. By default what the display is set to."""
    lattice: Lattice = Lattice.SQUARE
    """How the projector's pixels lie: `square`, or `diamond` as in a LightCrafter 4500."""
    curve: Literal["linear", "srgb"] = "linear"
    """How light follows pixel values: with `srgb` the patterns are drawn so that their light is as the plan
    has it; with `linear` they are drawn as they are, for a response measured by `fpplab gamma`."""
    channels: Annotated[tuple[Channel, ...], Field(min_length=1)] = CHANNELS
    """Colours in which patterns are drawn: all give white."""
    steady: bool = False
    """Whether the light is the same at all times within a refresh, as of LCD and LCoS without a colour wheel;
    otherwise exposures must last whole refreshes."""


class DisplayProjector(FlashingProjector):
    """A projector that shows a display of the computer, pixel by pixel.

    It has no trigger output: plans are stepped. The display is opened through SDL, unless the rig's bench
    provides `display`.
    """

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._options = chosen = config.validate(options, DisplayOptions, self.name)
        self._display: SdlDisplay = getattr(shared, "display", None) or SdlDisplay(
            self.name, chosen.display, chosen.size
        )
        self._pixels, self._light = pixel_table(self._is_curved), light_table(self._is_curved)
        self._held: list[NDArray[np.uint8]] = []

    def _open(self) -> None:
        self._display.open()
        self._held = []

    def _close(self) -> None:
        self._display.close()

    def _info(self) -> DeviceInfo:
        info = self._display.info
        assert info is not None, "hooks are called on an open device"
        link = "{} x {}, {:.4g} Hz".format(*info.size, 1.0 / self._display.vsync_s)
        return DeviceInfo("projector", f"display {info.index} '{info.name}'", "", link)

    def _caps(self) -> ProjectorCaps:
        info, vsync_s = self._display.info, self._display.vsync_s
        assert info is not None, "hooks are called on an open device"
        depths = CURVED_DEPTHS if self._is_curved else range(1, 9)
        return ProjectorCaps(
            info.size,
            self._options.lattice,
            dict.fromkeys(depths, vsync_s),
            trigger_outputs=0,
            max_patterns=MAX_PATTERNS,
            period_s=0.0 if self._options.steady else vsync_s,
        )

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._blank()
        quantised = [quantise(pattern.image / 255.0, pattern.bit_depth) for pattern in patterns]
        self._held = [self._pixels[image] for image in quantised]
        return [
            replace(pattern, image=self._light[pixels])
            for pattern, pixels in zip(patterns, self._held, strict=True)
        ]

    def _show(self, i: int) -> None:
        self._display.show(self._frame(self._held[i]))

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        raise NotImplementedError("there is no trigger output")

    def _blank(self) -> None:
        width, height = self._caps().size
        self._display.show(np.zeros((height, width, 3), np.uint8))

    def _refresh_period_s(self) -> float:
        return self._display.vsync_s

    def _flash(self, i: int, refreshes: int) -> None:
        self._display.show(self._frame(self._held[i]), refreshes)

    @property
    def _is_curved(self) -> bool:
        return self._options.curve == "srgb"

    def _frame(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        drawn = np.array([channel in self._options.channels for channel in CHANNELS])
        return np.where(drawn, pixels[..., None], np.uint8(0))


def srgb_light(values: ArrayLike) -> Floats:
    v = np.asarray(values, np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def srgb_values(light: ArrayLike) -> Floats:
    """Compute the pixel values of light, the inverse of `srgb_light`."""
    x = np.asarray(light, np.float64)
    return np.where(x <= 0.04045 / 12.92, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def pixel_table(is_srgb: bool) -> NDArray[np.uint8]:
    """Tabulate the pixel value to draw for each grey level of a pattern."""
    # returns (256,)
    greys = np.arange(256) / 255.0
    return np.asarray(np.rint(255.0 * (srgb_values(greys) if is_srgb else greys)), np.uint8)


def light_table(is_srgb: bool) -> NDArray[np.uint8]:
    """Tabulate the light of each pixel value, the inverse of `pixel_table`."""
    # returns (256,)
    values = np.arange(256) / 255.0
    return np.asarray(np.rint(255.0 * (srgb_light(values) if is_srgb else values)), np.uint8)
