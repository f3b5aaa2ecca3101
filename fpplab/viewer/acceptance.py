"""An acceptance test as it goes: each position's frames and cloud, then the fits' errors and the verdict."""

from __future__ import annotations

from typing import Any

import numpy as np

from fpplab.clouds import Cloud
from fpplab.comparison.acceptance import VERDICTS, Acceptance, MeasuredFeature
from fpplab.core.robust import error_limit
from fpplab.phase import Decoded
from fpplab.viewer import layouts
from fpplab.viewer.colours import ColourScale
from fpplab.viewer.measurement import Colouring, MeasurementView


class AcceptanceView(MeasurementView):
    """As a measurement, with the words of the result; the timeline `position` runs over the positions."""

    def begin(self) -> None:
        """Arrange the views."""
        self._positions = 0
        super().begin()

    def pictures(self) -> list[Any]:
        """List the views of images, and the result."""
        return [*super().pictures(), layouts.words("Result", "/words/result")]

    def position(self, item: str, decoded: Decoded, cloud: Cloud) -> None:
        """Show one position of a standard."""
        self._positions += 1
        self.canvas.text("words/result", f"**{item}**: {len(cloud):,} points, position {self._positions}")
        self.results(decoded, cloud, None, None)

    def result(self, found: Acceptance) -> None:
        """Show all fitted points by their distance from the fit, and the verdict."""
        features: list[MeasuredFeature] = [one.measured for bar in found.bars for one in bar.spheres]
        features += [plane.measured for plane in found.planes]
        errors_um = 1e3 * np.concatenate([one.distances for one in features])
        limit = error_limit(errors_um)
        scale = ColourScale("Signed distance from the fit", "µm", "RdBu_r", -limit, limit)
        shown = Colouring("Error", errors_um, scale)
        points = np.concatenate([one.points for one in features])
        self.canvas.cloud(shown.entity, points, scale.colours_of(errors_um))
        self.canvas.bar(f"bars/{shown.entity}", scale)
        self.canvas.open_on("part", "world/cloud", points)
        rows = "\n".join(
            f"| {name} | {one.worst_um:.1f} | {one.mpe_um or '–'} | {VERDICTS[one.passed]} |"
            for name, one in found.judgements().items()
        )
        self.canvas.text(
            "words/result",
            f"**{found.standard.name}: {VERDICTS[found.passed]}**\n\n"
            f"| | worst µm | permitted µm | |\n|---|---|---|---|\n{rows}",
        )
        self.canvas.layout(self.arrangement([shown]))
