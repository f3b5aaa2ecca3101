"""Gamma matching: the twin's response to uniform grey-level images made that of the bench.

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
from fpplab.matching.light import response_of
from fpplab.patterns.fringes import Pattern, uniform_patterns
from fpplab.patterns.response import Curve, Response
from fpplab.patterns.response_fit import GRID, MEAN, pixels_of_regions, statistics
from fpplab.simulation.matchable import Parameters, Twin

MOST_EPOCHS = 10
MATCHED = 0.002
"""Sum of squares at which the paper's matching ends, levels as shares of full scale."""
SETTLED = 1e-9
"""Gain of the sum of squares from which there is nothing more to gain."""


@dataclass(frozen=True, eq=False)
class GammaEpoch:
    """One evaluation of the twin. levels: (L,), what it sees, as shares of full scale."""

    parameters: Parameters
    levels: Floats
    sum_of_squares: float


@dataclass(frozen=True, eq=False)
class GammaMatch:
    """The bench's levels (L,) shown and seen, and every epoch; the last is the best."""

    shown: Floats
    seen: Floats
    epochs: tuple[GammaEpoch, ...]

    @property
    def parameters(self) -> Parameters:
        return self.epochs[-1].parameters

    def summary(self) -> dict[str, float]:
        """W, a, b, g of the twin and what they leave."""
        found = self.parameters
        return {
            "W": found.white,
            "a": found.response.a,
            "b": found.response.b,
            "g": found.response.g,
            "sum_of_squares": self.epochs[-1].sum_of_squares,
            "epochs": len(self.epochs),
        }


def match_gamma(twin: Twin, response: Response, item: str, settings: CameraSettings) -> GammaMatch:
    """Make the twin see a card `item` in uniform grey-level images as the bench did.

    response: the bench's, with the levels that were fitted. Starts from its fit. Leaves the twin matched.
    Raises `CalibrationError` when the response holds no levels or the twin cannot come near.
    """
    if len(response.measured) == 0:
        raise CalibrationError("the response file holds no levels; measure it again with `fpplab gamma`")
    shown = np.array([level.shown for level in response.measured])
    seen = np.array([level.seen for level in response.measured])
    card = Card(twin, item, settings, response)
    start = _normalised(response)
    twin.become(replace(twin.parameters, response=response_of(start.g, start.b)))
    _match_dark(card, response)
    epochs = [_epoch(card, shown, seen)]
    while len(epochs) < MOST_EPOCHS:
        twin.become(_better(card, epochs[-1], shown, seen))
        epochs.append(_epoch(card, shown, seen))
        if epochs[-2].sum_of_squares - epochs[-1].sum_of_squares < SETTLED:
            break
    if epochs[-1].sum_of_squares > epochs[-2].sum_of_squares:
        epochs.pop()
    twin.become(epochs[-1].parameters)
    if epochs[-1].sum_of_squares > MATCHED:
        raise CalibrationError(
            f"gamma: no response of the twin comes nearer to the bench's levels than a sum of squares of "
            f"{epochs[-1].sum_of_squares:.2g}, and {MATCHED:g} is needed; see that both look at a white card"
        )
    return GammaMatch(shown, seen, tuple(epochs))


@dataclass(frozen=True, eq=False)
class Card:
    """The twin in front of a card, seen in the regions that the bench's response was fitted in."""

    twin: Twin
    item: str
    settings: CameraSettings
    response: Response

    def levels(self, shown: Floats) -> Floats:
        """Mean levels (L,) of uniform grey-level images, as shares of full scale."""
        greys = [round(255 * level) for level in shown.tolist()]
        return self._means(uniform_patterns(greys, self.twin.parameters.calibration.projector.size))

    def dark(self) -> float:
        """The mean level without the projector's light."""
        lit = self.twin.parameters
        self.twin.become(replace(lit, response=Curve(a=1.0, b=0.0, g=1.0)))
        level = float(self.levels(np.zeros(1))[0])
        self.twin.become(lit)
        return level

    def _means(self, patterns: list[Pattern]) -> Floats:
        chosen = np.zeros(GRID**2, bool)
        for region in self.response.regions:
            chosen[region.row * GRID + region.column] = True
        chosen |= not chosen.any()
        found = []
        for pattern in patterns:
            image = self.twin.expected_of(self.item, [pattern], self.settings)[0] / full_scale(
                self.settings.bits
            )
            weight = pixels_of_regions(image)[chosen]
            # As shares of full scale already, which is one bit's.
            found.append(statistics(image, 1)[MEAN, chosen] @ weight / weight.sum())
        return np.array(found)


def _normalised(response: Response) -> Curve:
    """The bench's response with the dark level off, and its white as 1."""
    dark = response.dark[0] if response.dark else min(level.seen for level in response.measured)
    white = response.a + response.b - dark
    black = min(max((response.b - dark) / white, 0.0), 0.5)
    return response_of(response.g, black)


def _match_dark(card: Card, response: Response) -> None:
    """By ambient light if the bench is brighter than the twin's black level, otherwise by that."""
    if response.dark is None:
        return
    twin = card.twin
    now = twin.parameters
    twin.become(replace(now, ambient=0.0))
    without = card.dark()
    wanted = response.dark[0]
    if wanted < without:
        twin.become(replace(now, ambient=0.0, black_level=max(0.0, now.black_level - (without - wanted))))
        return
    probe = 0.05
    twin.become(replace(now, ambient=probe))
    per_ambient = (card.dark() - without) / probe
    twin.become(replace(now, ambient=(wanted - without) / per_ambient if per_ambient > 0 else now.ambient))


def _epoch(card: Card, shown: Floats, seen: Floats) -> GammaEpoch:
    levels = card.levels(shown)
    return GammaEpoch(card.twin.parameters, levels, float(np.sum((seen - levels) ** 2)))


def _better(card: Card, last: GammaEpoch, shown: Floats, seen: Floats) -> Parameters:
    """W, b, g by the law, whose factor from light to level the last epoch tells; the dark level is kept."""
    now = last.parameters
    dark = card.dark()
    light = now.response.apply(shown)
    factor = float(light @ (last.levels - dark) / (light @ light))

    def misfit(unknown: Floats) -> Floats:
        white, black, g = unknown
        return np.asarray(dark + factor * white * ((1 - black) * shown**g + black) - seen)

    found = least_squares(
        misfit, [1.0, now.response.b, now.response.g], bounds=([0.01, 0, 0.2], [100, 0.5, 5])
    )
    white, black, g = (float(x) for x in found.x)
    return replace(now, white=now.white * white, response=response_of(g, black), ambient=now.ambient / white)
