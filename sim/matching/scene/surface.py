"""Reflectance, gloss and translucency of a part, from the bench's scan of it.

Light is linear: a level above black is `(1 - s) ρ D + s G`, with the levels D of a white matt part and G of
one whose coat meets all light, both of the twin at a short exposure, where nothing is clipped. Reflectance ρ
and share s of the coat are thus linear least squares for each width of the coat, which is searched. A
saturated level says that there is at least so much light. Which kind of surface it is Schwarz's criterion
decides, as for effects of the bench.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, nnls

from fpplab.core.conventions import Floats, PixelIndices, full_scale
from fpplab.core.errors import DataError
from fpplab.core.robust import HUBER, huber_weights, multiway_covariance, robust_spread
from fpplab.patterns.fringes import Pattern, make_patterns
from sim.matching.loss import subsample_pixels
from sim.matching.samples import tile_numbers
from sim.matching.scene.artefacts import CLIPPED, SHORT, BenchScan, lit_inside
from sim.parameters import TwinParameters
from sim.part_surface import PartSurface
from sim.twin import Twin


@dataclass(frozen=True)
class SurfaceLimits:
    """How the surface of a part is found."""

    pixels: int = 4_000  # of a scan that are compared, about (chosen, for speed)
    min_pixels: int = 50  # that determine a surface (chosen)
    min_width: float = 0.08  # of a gloss coat, the square root of GGX's (chosen)
    max_width: float = 0.9  # of a gloss coat (chosen)
    rounds: int = 8  # robust fits (chosen)
    tolerance: float = 0.05  # of the search for a width, relative; Newton's steps follow (chosen)
    newton_steps: int = 2  # after the search (chosen)
    step_factor: float = 1.05  # of a width for its derivative (numerical)


LIMITS = SurfaceLimits()

WIDTHS = (0.15, 0.25, 0.4, 0.6)
"""Widths of the gloss coat (square root of GGX's) with which the search starts."""


@dataclass(frozen=True, eq=False)
class SurfaceMatch:
    """The surface of a part."""

    scan: BenchScan  # that it was matched to
    surface: PartSurface  # with standard uncertainties
    criterion: dict[str, float]  # schwarz's criterion of every kind of surface that was tried
    unexplained: float  # RMS difference of levels that is left, relative to their mean
    explained: float
    saturated: float  # share of the compared levels that are saturated on the bench

    def summary(self) -> dict[str, Any]:
        return {
            "item": self.scan.item,
            **self.surface.summary(),
            "criterion": self.criterion,
            "unexplained": self.unexplained,
            "explained": self.explained,
            "saturated": self.saturated,
        }


def with_surfaces(parameters: TwinParameters, matches: Sequence[SurfaceMatch]) -> TwinParameters:
    """Give a twin the surfaces of parts, and put the parts where their scans show them."""
    surfaces = {match.scan.item: match.surface for match in matches}
    placed = {match.scan.item: match.scan.T_camera_item for match in matches}
    return replace(
        parameters, surfaces={**parameters.surfaces, **surfaces}, placed={**parameters.placed, **placed}
    )


def match_surface(twin: Twin, scan: BenchScan) -> SurfaceMatch:
    view = _View(twin, scan)
    own = view.remaining(view.own)
    matt = view.fitted(view.component(PartSurface(1.0))[:, None])
    glossy, width = _searched_width(view)
    fits = {"diffuse": (matt, 1), "glossy": (glossy, 3)}
    spread = min(fit.spread for fit, _ in fits.values())
    criterion = {name: view.criterion(fit, spread, free) for name, (fit, free) in fits.items()}
    if min(criterion, key=lambda name: criterion[name]) == "diffuse":
        best, surface = matt, view.matt_surface(matt)
    else:
        best, surface = glossy, view.glossy_surface(glossy, width)
    return SurfaceMatch(
        view.scan,
        surface,
        criterion,
        best.rms,
        1.0 - best.mean_square / max(own.mean_square, 1e-12),
        float(np.mean(view.clipped)),
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Coefficients (K,) of light, with residuals and weights of all levels."""

    coefficients: Floats
    columns: Floats
    residual: Floats
    weight: Floats
    level: float

    @cached_property
    def spread(self) -> float:
        return robust_spread(self.residual * np.sqrt(self.weight))

    @property
    def mean_square(self) -> float:
        return float(np.mean(self.residual**2))

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.mean_square)) / self.level


def _searched_width(view: _View) -> tuple[_Fit, float]:
    """Search the width of the coat with the lowest cost, which the nearest of the starts encloses."""
    fits = {width: view.fitted(view.glossy(width)) for width in WIDTHS}

    def cost(logarithm: float) -> float:
        width = float(np.exp(logarithm))
        fits[width] = view.fitted(view.glossy(width))
        return view.cost(fits[width])

    def best() -> float:
        return min(fits, key=lambda width: view.cost(fits[width]))

    ends = [LIMITS.min_width, *WIDTHS, LIMITS.max_width]
    place = ends.index(best())
    bounds = np.log([ends[place - 1], ends[place + 1]])
    minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": LIMITS.tolerance, "maxiter": 6})
    for _ in range(LIMITS.newton_steps):
        width = best()
        further = view.width_step(fits[width], width)
        cost(float(np.log(np.clip(width + further, LIMITS.min_width, LIMITS.max_width))))
    return fits[best()], best()


class _View:
    """Levels of a scan at some pixels, and the twin's for any surface."""

    def __init__(self, twin: Twin, scan: BenchScan) -> None:
        self.twin, self.scan = twin, scan
        self._now, session = twin.parameters, scan.session
        size, lattice = session.projector()
        self.patterns: tuple[Pattern, ...] = make_patterns(session.plan, size, lattice)
        self.settings = scan.compared_pass.settings
        self.full = float(full_scale(self.settings.bits))
        self.pixels = self._lit_pixels()
        frames = scan.levels(range(len(self.patterns)), self.pixels)
        self.tiles: NDArray[np.int64] = np.tile(tile_numbers(self.pixels), len(frames))
        levels = frames.ravel()
        self.clipped = levels >= CLIPPED * self.full
        if np.mean(self.clipped) > 0.95:
            raise DataError(f"{session.path}: is saturated; expose it shorter")
        self.black = self._now.black_level * self.full
        self.above_black: Floats = levels - self.black
        # Shot noise and faults of the light both grow with the level: highlights must not decide alone.
        mean = np.maximum(frames.mean(axis=0) - self.black, 1.0)
        self.precision: Floats = np.tile(1.0 / mean, len(frames))
        self.own = self.component(None)

    def _lit_pixels(self) -> PixelIndices:
        inner = lit_inside(self.twin, self.scan)
        if np.count_nonzero(inner) < LIMITS.min_pixels:
            raise DataError(
                f"{self.scan.session.path}: {np.count_nonzero(inner)} pixels see lit surface of the "
                f"{self.scan.item} away from its edges; it takes {LIMITS.min_pixels} to determine its surface"
            )
        return subsample_pixels(inner, LIMITS.pixels)

    def component(self, surface: PartSurface | None) -> Floats:
        """Levels above black (n P,) of a surface, None for that of the twin, not clipped."""
        twin = self.twin
        if surface is not None:
            surfaces = {**self._now.surfaces, self.scan.item: surface}
            twin = twin.with_parameters(replace(self._now, surfaces=surfaces))
        settings = replace(self.settings, exposure_s=SHORT * self.settings.exposure_s)
        levels = twin.expected_part(
            self.scan.item, self.scan.T_camera_item, self.patterns, settings, self.pixels
        )
        return (levels.astype(np.float64).ravel() - self.black) / SHORT

    def glossy(self, width: float) -> Floats:
        """Columns (n P, 2): of the white matt body, and of the coat alone."""
        return np.stack([self._matt, self.component(PartSurface(0.0, 1.0, width))], axis=1)

    @cached_property
    def _matt(self) -> Floats:
        return self.component(PartSurface(1.0))

    def remaining(self, levels: Floats) -> _Fit:
        return self._fit(np.ones(1), levels[:, None])

    def fitted(self, columns: Floats) -> _Fit:
        keep, weight = ~self.clipped, self.precision
        for _ in range(LIMITS.rounds):
            root = np.sqrt(weight[keep])
            coefficients, _ = nnls(columns[keep] * root[:, None], self.above_black[keep] * root)
            fit = self._fit(coefficients, columns)
            scaled = fit.residual * np.sqrt(self.precision)
            spread = robust_spread(scaled[~self.clipped])
            weight = self.precision * huber_weights(scaled, spread)
            keep = ~self.clipped | (fit.residual > 0)
        return self._fit(coefficients, columns)

    def _fit(self, coefficients: Floats, columns: Floats) -> _Fit:
        residual = self.above_black - columns @ coefficients
        residual = np.where(self.clipped, np.maximum(residual, 0.0), residual)
        return _Fit(coefficients, columns, residual, self.precision, float(self.above_black.mean()))

    def cost(self, fit: _Fit, spread: float | None = None) -> float:
        """Mean of Huber's function of the residuals."""
        scaled = np.abs(fit.residual) * np.sqrt(self.precision)
        limit = HUBER * (self._spread if spread is None else spread)
        return float(np.mean(np.where(scaled < limit, scaled**2, 2 * limit * scaled - limit**2)))

    @cached_property
    def _spread(self) -> float:
        return self.fitted(self._matt[:, None]).spread

    def criterion(self, fit: _Fit, spread: float, free: int) -> float:
        """Schwarz's criterion; residuals of one tile of an image count as one."""
        count = len(self.patterns) * len(np.unique(self.tiles))
        return float(count * np.log(max(self.cost(fit, spread), 1e-12)) + free * np.log(count))

    def matt_surface(self, fit: _Fit) -> PartSurface:
        sigma = float(np.sqrt(self._covariance(fit, fit.columns)[0, 0]))
        return PartSurface(
            min(float(fit.coefficients[0]), 1.0), sigma={"reflectance": self._with_white(sigma, fit)}
        )

    def glossy_surface(self, fit: _Fit, width: float) -> PartSurface:
        body, share = fit.coefficients.tolist()
        share = min(share, 0.999)
        covariance = self._covariance(fit, self._slopes(fit, width))
        below_coat = 1.0 - share
        of_reflectance = np.array([1.0 / below_coat, body / below_coat**2, 0.0])
        reflectance = float(np.sqrt(of_reflectance @ covariance @ of_reflectance))
        return PartSurface(
            min(body / below_coat, 1.0),
            share,
            width,
            sigma={
                "reflectance": self._with_white(reflectance, fit),
                "gloss": float(np.sqrt(covariance[1, 1])),
                "gloss_roughness": float(np.sqrt(covariance[2, 2])),
            },
        )

    def width_step(self, fit: _Fit, width: float) -> float:
        """By how much another width would be better, to first order."""
        slopes, weight = self._slopes(fit, width), self._weights(fit)
        step = np.linalg.pinv(slopes.T @ (weight[:, None] * slopes)) @ (slopes.T @ (weight * fit.residual))
        return float(step[2])

    def _slopes(self, fit: _Fit, width: float) -> Floats:
        """Derivatives (n P, 3) by body, share and width of the coat."""
        wider = self.glossy(width * LIMITS.step_factor)[:, 1]
        by_width = fit.coefficients[1] * (wider - fit.columns[:, 1]) / (width * (LIMITS.step_factor - 1.0))
        return np.column_stack([fit.columns, by_width])

    def _with_white(self, sigma: float, fit: _Fit) -> float:
        """Add the uncertainty of the white level, which the board determined."""
        parameters = self._now
        relative = [
            parameters.sigma.get(name, 0.0) / max(getattr(parameters, name), 1e-6)
            for name in ("white", "paper")
        ]
        return float(np.hypot(sigma, fit.coefficients[0] * max(relative)))

    def _weights(self, fit: _Fit) -> Floats:
        scaled = fit.residual * np.sqrt(self.precision)
        weight = self.precision * huber_weights(scaled, fit.spread)
        return np.where(self.clipped & (fit.residual <= 0), 0.0, weight)

    def _covariance(self, fit: _Fit, slopes: Floats) -> Floats:
        """Of the sandwich form: residuals of one tile of the part count as dependent, over all images."""
        weight = self._weights(fit)
        scores = slopes * (weight * fit.residual)[:, None]
        inverse = np.linalg.pinv(slopes.T @ (weight[:, None] * slopes))
        return multiway_covariance(inverse, scores, [self.tiles])
