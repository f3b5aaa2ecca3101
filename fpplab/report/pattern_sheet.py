"""The patterns of a plan on one sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from fpplab.core.drawing import FULL, as_png, new_figure
from fpplab.patterns.fringes import Pattern

COLUMNS = 6
ROW_HEIGHT = 1.25
"""Height in inches of a row of patterns."""


@as_png
def pattern_sheet(patterns: Sequence[Pattern]) -> Figure:
    """Draw patterns as they are loaded, in their order from the upper left, each with its id.

    They are reduced by averaging: stripes that are too fine for the sheet appear grey.
    """
    rows = -(-len(patterns) // COLUMNS)
    figure = new_figure(FULL, rows * ROW_HEIGHT)
    sheets = np.atleast_1d(figure.subplots(rows, COLUMNS)).ravel()
    for axes in sheets:
        axes.set_axis_off()
    for axes, pattern in zip(sheets, patterns, strict=False):
        axes.imshow(pattern.image, cmap="gray", vmin=0, vmax=255, aspect="auto", interpolation="antialiased")
        axes.set_title(pattern.id, fontsize=6.5)
    return figure
