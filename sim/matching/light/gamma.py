"""Gamma matching: the twin's response to uniform grey-level images is fitted to that of the bench.

Least squares of mean DC levels, `min Σ (x_i - x̂_i(W, a, b, g))²`, as in the paper. W and a are one factor of
the levels, so a + b = 1 here and W takes the scale; the dark level, which is not the projector's, is matched
by ambient light and the camera's black level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from fpplab.core.conventions import Floats, full_scale
from fpplab.core.errors import CalibrationError
from fpplab.devices import CameraSettings
from fpplab.patterns.curve import Curve
from fpplab.patterns.response import Response
from fpplab.patterns.response_fit import GRID, MEAN, pixels_of_regions, statistics
from sim.parameters import TwinParameters, normalised_response
from sim.twin import Twin


@dataclass(frozen=True)
class GammaLimits:
    """When the fit of a response ends."""

    max_epochs: int = 10  # evaluations of the twin (chosen)
    max_sum_of_squares: float = 0.002  # of levels as shares of full scale (the paper's)
    min_gain: float = 1e-9  # of the sum of squares (numerical)


LIMITS = GammaLimits()


@dataclass(frozen=True, eq=False)
class GammaEpoch:
    """One evaluation of the twin."""

    parameters: TwinParameters  # the twin's parameters in this epoch
    levels: Floats  # mean levels (L,) that the twin's camera sees, as shares of full scale
    sum_of_squares: float  # of the differences from the reference's levels


@dataclass(frozen=True, eq=False)
class GammaMatch:
    """Result of a gamma matching."""

    shown: Floats  # levels (L,) shown on the bench, as shares of full scale
    recorded: Floats  # mean levels (L,) that the bench's camera saw, as shares of full scale
    epochs: tuple[GammaEpoch, ...]  # all evaluations in their order; the last is the best

    @property
    def parameters(self) -> TwinParameters:
        return self.epochs[-1].parameters

    def summary(self) -> dict[str, float]:
        parameters = self.parameters
        return {
            "W": parameters.white,
            "a": parameters.response.a,
            "b": parameters.response.b,
            "g": parameters.response.g,
            "sum_of_squares": self.epochs[-1].sum_of_squares,
            "epochs": len(self.epochs),
        }


def match_gamma(twin: Twin, response: Response, item: str, settings: CameraSettings) -> GammaMatch:
    """Fit the twin's response, so that it sees a card in uniform grey levels as the bench did."""
    # Starts from the fit of the measured response.
    if len(response.measured) == 0:
        raise CalibrationError("the response file holds no levels; measure it again with `fpplab gamma`")
    shown, recorded = _measured(response)
    start = replace(twin.parameters, response=_normalised_response(response))
    card = GreyCard(twin.with_parameters(start), item, settings, response)
    card = card.with_parameters(_with_matched_dark(card, response))
    epochs = [_epoch(card, shown, recorded)]
    while len(epochs) < LIMITS.max_epochs:
        card = card.with_parameters(_fitted_parameters(card, epochs[-1], shown, recorded))
        epochs.append(_epoch(card, shown, recorded))
        if epochs[-2].sum_of_squares - epochs[-1].sum_of_squares < LIMITS.min_gain:
            break
    if epochs[-1].sum_of_squares > epochs[-2].sum_of_squares:
        epochs.pop()
    if epochs[-1].sum_of_squares > LIMITS.max_sum_of_squares:
        raise CalibrationError(
            f"gamma: no response of the twin fits the bench's levels: the smallest sum of squares is "
            f"{epochs[-1].sum_of_squares:.2g}, but {LIMITS.max_sum_of_squares:g} is needed; make sure that "
            "both look at a white card"
        )
    return GammaMatch(shown, recorded, tuple(epochs))


def with_level_of_card(twin: Twin, response: Response, item: str, settings: CameraSettings) -> TwinParameters:
    """Scale the lamp so that the twin sees the card as bright as the bench did, and its board as before."""
    # Vignetting and falloff are found on the board, after the response. They change what the card shows, and
    # the board's reflectance alone would make up for that: every other part would be too dark or too bright.
    now, card = twin.parameters, GreyCard(twin, item, settings, response)
    shown, recorded = _measured(response)
    own_dark = card.dark_level()
    own = card.levels(shown) - own_dark
    lit = recorded - (response.dark[0] if response.dark else own_dark)
    # No board reflects more than all light.
    factor = max(float(own @ lit / (own @ own)), now.paper)
    scaled = {name: now.sigma[name] / factor for name in ("paper", "ink") if name in now.sigma}
    return replace(
        now,
        white=now.white * factor,
        paper=now.paper / factor,
        ink=now.ink / factor,
        sigma={**now.sigma, **scaled},
    )


def _measured(response: Response) -> tuple[Floats, Floats]:
    """Levels (L,) shown and seen."""
    return np.array([level.shown for level in response.measured]), np.array(
        [level.seen for level in response.measured]
    )


@dataclass(frozen=True, eq=False)
class GreyCard:
    """The twin in front of a grey card, in the image regions where the bench's response was fitted."""

    twin: Twin  # whose camera looks at the card
    item: str  # the card, as the twin's fixture calls it
    settings: CameraSettings  # of the camera
    response: Response  # measured on the bench; names the regions

    def with_parameters(self, parameters: TwinParameters) -> GreyCard:
        return replace(self, twin=self.twin.with_parameters(parameters))

    def levels(self, shown: Floats) -> Floats:
        """Give the mean levels that the twin's camera sees of uniform grey-level images."""
        # shown (L,); returns (L,)
        chosen = np.zeros(GRID**2, bool)
        for region in self.response.regions:
            chosen[region.row * GRID + region.column] = True
        chosen |= not chosen.any()
        means = []
        for levels in self.twin.expected_of_greys(self.item, np.rint(255 * shown) / 255, self.settings):
            image = levels / full_scale(self.settings.bits)
            weight = pixels_of_regions(image)[chosen]
            # The image is in shares of full scale already; the full scale of one bit is 1.
            means.append(statistics(image, 1)[MEAN, chosen] @ weight / weight.sum())
        return np.array(means)

    def dark_level(self) -> float:
        """Give the mean level without the projector's light."""
        black = replace(self.twin.parameters, response=Curve(a=1.0, b=0.0, g=1.0))
        return float(self.with_parameters(black).levels(np.zeros(1))[0])


def _normalised_response(response: Response) -> Curve:
    """Take the dark level off the measured response and scale its white to 1."""
    dark_level = response.dark[0] if response.dark else min(level.seen for level in response.measured)
    white = response.a + response.b - dark_level
    black = min(max((response.b - dark_level) / white, 0.0), 0.5)
    return normalised_response(response, black=black)


def _with_matched_dark(card: GreyCard, response: Response) -> TwinParameters:
    """Match the dark level by ambient light, or by the black level where the bench is darker than that."""
    now = card.twin.parameters
    if response.dark is None:
        return now
    without = card.with_parameters(replace(now, ambient=0.0)).dark_level()
    dark = response.dark[0]
    if dark < without:
        return replace(now, ambient=0.0, black_level=max(0.0, now.black_level - (without - dark)))
    probe = 0.05
    per_ambient = (card.with_parameters(replace(now, ambient=probe)).dark_level() - without) / probe
    return replace(now, ambient=(dark - without) / per_ambient if per_ambient > 0 else now.ambient)


def _epoch(card: GreyCard, shown: Floats, recorded: Floats) -> GammaEpoch:
    levels = card.levels(shown)
    return GammaEpoch(card.twin.parameters, levels, float(np.sum((recorded - levels) ** 2)))


def _fitted_parameters(card: GreyCard, last: GammaEpoch, shown: Floats, recorded: Floats) -> TwinParameters:
    """Fit W, b, g with the scale from light to level of the last epoch; the dark level is held."""
    now = last.parameters
    dark_level = card.dark_level()
    light, shape = now.response.apply(shown), now.response
    factor = float(light @ (last.levels - dark_level) / (light @ light))

    def misfit(unknown: Floats) -> Floats:
        return np.asarray(dark_level + factor * unknown[0] * response_of(unknown).apply(shown) - recorded)

    def response_of(unknown: Floats) -> Curve:
        # A spline's shape is that of the measured levels already; only black and white are left.
        g = shape.g if shape.spline else float(unknown[2])
        return normalised_response(shape, black=float(unknown[1]), g=g)

    start, bounds = [1.0, shape.b, shape.g], ([0.01, 0.0, 0.2], [100.0, 0.5, 5.0])
    free = 2 if shape.spline else 3
    fitted = least_squares(misfit, start[:free], bounds=(bounds[0][:free], bounds[1][:free])).x
    white = float(fitted[0])
    return replace(now, white=now.white * white, response=response_of(fitted), ambient=now.ambient / white)
