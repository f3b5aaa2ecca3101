"""Figures of the response of projector and camera, and of the levels seen of a synchronisation marker."""

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.drawing import ACCENT, FULL, SECOND, as_png, new_figure, side_by_side
from fpplab.core.errors import DataError
from fpplab.diagnosis.causes.of_rig_check import draw_marker_levels
from fpplab.patterns.response import Response


@as_png
def response_curve(response: Response, levels: Floats) -> Figure:
    # levels (K, 2)
    shown, measured = levels.T
    axis = np.linspace(0, 1, 200)
    figure, (left, right) = side_by_side(3.2, (1.3, 1.0))
    left.plot(axis, response.apply(axis), color=SECOND, linewidth=1.5, label=_formula(response))
    left.plot(shown, measured, "o", color=ACCENT, markersize=4, label="measured")
    left.set(
        xlabel="level shown, of full scale",
        ylabel="level seen, of full scale",
        xlim=(-0.02, 1.02),
        ylim=(min(0.0, float(measured.min())), None),
    )
    left.legend(loc="upper left")
    residuals = 255 * (measured - response.apply(shown))
    right.axhline(0, color=SECOND, linewidth=1.2)
    right.vlines(shown, 0, residuals, color=ACCENT, linewidth=1.0)
    right.plot(shown, residuals, "o", color=ACCENT, markersize=4)
    right.set(
        xlabel="level shown, of full scale",
        ylabel="measured − fitted, in grey levels of 255",
        xlim=(-0.02, 1.02),
    )
    return figure


@as_png
def response_fit(response: Response) -> Figure:
    # Error bars span two standard uncertainties each way.
    if not response.measured or not response.regions:
        raise DataError("the response holds no levels and regions to draw; measure it with `fpplab gamma`")
    shown, measured, residuals = np.array([(p.shown, p.seen, p.residual) for p in response.measured]).T
    error = 2 * np.array([p.sigma or 0.0 for p in response.measured])
    figure = new_figure(FULL, 3.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0), height_ratios=(1.7, 1.0))
    curve, misfit = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    axis = np.linspace(0, 1, 200)
    curve.plot(axis, response.apply(axis), color=SECOND, linewidth=1.5, label=_formula(response))
    curve.errorbar(
        shown,
        measured,
        error,
        fmt="o",
        color=ACCENT,
        markersize=3.5,
        label="seen, ± 2 standard uncertainties",
        capsize=2,
    )
    curve.set(ylabel="level seen, of full scale", xlim=(-0.02, 1.02))
    curve.legend(loc="upper left")
    misfit.axhline(0, color=SECOND, linewidth=1.2)
    misfit.errorbar(shown, 255 * residuals, 255 * error, fmt="o", color=ACCENT, markersize=3.5, capsize=2)
    misfit.set(
        xlabel="level shown, of full scale", ylabel="seen − fitted\nin grey levels of 255", xlim=(-0.02, 1.02)
    )
    _region_exponents(figure.add_subplot(grid[:, 1]), response)
    return figure


def _region_exponents(axes: Axes, response: Response) -> None:
    names = [f"{r.row + 1}, {r.column + 1}" for r in response.regions]
    place = np.arange(len(names))
    reach = 2 * response.sigma[2]
    axes.axvspan(response.g - reach, response.g + reach, color=SECOND, alpha=0.25, linewidth=0)
    axes.axvline(response.g, color=SECOND, linewidth=1.2)
    axes.errorbar(
        [r.g for r in response.regions],
        place,
        xerr=[2 * r.sigma_g for r in response.regions],
        fmt="o",
        color=ACCENT,
        markersize=3.5,
        capsize=2,
    )
    axes.set_yticks(place, names)
    axes.set(xlabel="exponent g of each region", ylabel="region: row, column", ylim=(len(names) - 0.5, -0.5))
    axes.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%.4f"))
    axes.xaxis.set_major_locator(mpl.ticker.MaxNLocator(4))


@as_png
def marker_levels(shown: NDArray[np.integer[Any]], runs: Mapping[str, Floats]) -> Figure:
    # shown (K,); seen of (K,)
    return draw_marker_levels(shown, runs)


def _formula(response: Response) -> str:
    sign = "+" if response.b >= 0 else "−"
    if response.spline:
        return f"{response.a:.3f} · S(level) {sign} {abs(response.b):.3f}"
    return rf"{response.a:.3f} · level$^{{{response.g:.3f}}}$ {sign} {abs(response.b):.3f}"
