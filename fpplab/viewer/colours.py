"""Colours of values, and the colour bars that say which value and unit a colour means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pixels
from PIL import ImageDraw

from fpplab.core.conventions import Floats
from fpplab.report.map_sheet import colour_table, label_font

UNMEASURED = (185, 188, 192)  # RGB of what was not measured
BAR_SIZE = (560, 92)  # width and height of a colour bar in px
_PAPER, _INK = (24, 27, 31), (225, 228, 232)
_MARGIN, _HEIGHT = 60, 30


@dataclass(frozen=True)
class ColourScale:
    """What a range of values looks like."""

    quantity: str  # what is shown, as the colour bar says it
    unit: str  # of the values; empty for a pure number
    colours: str  # name of a colour map of matplotlib
    low: float  # values of its ends; what lies beyond looks like them
    high: float  # values of its ends; what lies beyond looks like them

    @classmethod
    def spanning(
        cls, quantity: str, unit: str, colours: str, values: NDArray[np.floating[Any]]
    ) -> ColourScale:
        finite = values[np.isfinite(values)]
        low, high = np.percentile(finite, (0.5, 99.5)) if len(finite) else (0.0, 1.0)
        return cls(quantity, unit, colours, float(low), float(high))

    def colours_of(self, values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
        level: Floats = np.clip((values - self.low) / max(self.high - self.low, 1e-12), 0.0, 1.0)
        finite = np.isfinite(level)
        rgb: NDArray[np.uint8] = colour_table(self.colours)[
            np.rint(np.where(finite, level, 0.0) * 255).astype(np.intp)
        ]
        rgb[~finite] = UNMEASURED
        return rgb

    def above_its_bar(self, values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
        # values (h, w)
        shown = self.colours_of(values)
        larger = -(-BAR_SIZE[0] // shown.shape[1])
        shown = shown.repeat(larger, axis=0).repeat(larger, axis=1)
        bar = Pixels.fromarray(self.bar())
        across = shown.shape[1]
        bar = bar.resize((across, round(bar.height * across / bar.width)), Pixels.Resampling.BILINEAR)
        return np.concatenate([shown, np.asarray(bar)])

    def bar(self) -> NDArray[np.uint8]:
        width, height = BAR_SIZE
        sheet = Pixels.new("RGB", BAR_SIZE, _PAPER)
        across = width - 2 * _MARGIN
        ramp = colour_table(self.colours)[np.linspace(0, 255, across).astype(np.intp)]
        sheet.paste(Pixels.fromarray(np.repeat(ramp[None], _HEIGHT, axis=0)), (_MARGIN, 2))
        draw, font = ImageDraw.Draw(sheet), label_font(19)
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            x = _MARGIN + share * (across - 1)
            draw.line([(x, _HEIGHT), (x, _HEIGHT + 7)], fill=_INK, width=2)
            value = self.low + share * (self.high - self.low)
            draw.text((x, _HEIGHT + 8), self._number(value), _INK, font, anchor="ma")
        title = f"{self.quantity} in {self.unit}" if self.unit else self.quantity
        draw.text((width / 2, height - 3), title, _INK, font, anchor="mb")
        return np.asarray(sheet)

    def _number(self, value: float) -> str:
        span = abs(self.high - self.low)
        if span >= 1e5 or 0 < span < 1e-3:
            return f"{value:.2g}"
        places = int(np.clip(2 - np.floor(np.log10(max(span, 1e-12))), 0, 5))
        return f"{value:.{places}f}"
