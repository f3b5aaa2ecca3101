"""An acceptance test as it goes: each position's frames and cloud, then the fits' errors and the verdict."""

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
    """As a measurement, with the result as text; the timeline `position` runs over the positions."""

    def arrange_views(self) -> None:
        self._positions = 0
        super().arrange_views()

    def pictures(self) -> list[Any]:
        return [*super().pictures(), layouts.text_view("Result", "/words/result")]

    def position(self, item: str, decoded: Decoded, cloud: Cloud) -> None:
        self._positions += 1
        self.canvas.text("words/result", f"**{item}**: {len(cloud):,} points, position {self._positions}")
        self.results(decoded, cloud, None, None)

    def result(self, acceptance: Acceptance) -> None:
        features: list[MeasuredFeature] = [
            feature.measured for bar in acceptance.bars for feature in bar.spheres
        ]
        features += [plane.measured for plane in acceptance.planes]
        errors_um = 1e3 * np.concatenate([feature.distances for feature in features])
        limit = error_limit(errors_um)
        scale = ColourScale("Signed distance from the fit", "µm", "RdBu_r", -limit, limit)
        shown = Colouring("Error", errors_um, scale)
        points = np.concatenate([feature.points for feature in features])
        self.canvas.cloud(shown.entity, points, scale.colours_of(errors_um))
        self.canvas.bar(f"bars/{shown.entity}", scale)
        self.canvas.open_on("part", "world/cloud", points)
        rows = "\n".join(
            f"| {name} | {verdict.worst_um:.1f} | {verdict.mpe_um or '–'} | {VERDICTS[verdict.passed]} |"
            for name, verdict in acceptance.judgements().items()
        )
        self.canvas.text(
            "words/result",
            f"**{acceptance.standard.name}: {VERDICTS[acceptance.passed]}**\n\n"
            f"| | worst µm | permitted µm | |\n|---|---|---|---|\n{rows}",
        )
        self.canvas.arrange(self.arrangement([shown]))
