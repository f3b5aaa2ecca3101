"""A bench compared with its twin: prediction and measurement, and the frames of both by either's calibration.

With its own calibration a rig hides what is wrong with it; with the other's it shows in how far the two
describe the same bench.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.recording import Recording
from fpplab.phase.exposures import merged_recording
from fpplab.sessions.session import Session
from sim.bench import VirtualBench
from sim.matching.judging.measured import measured_figures, recorded_figures
from sim.matching.judging.plausibility import check_devices
from sim.prediction import MeasuredFigures, Prediction, predict


@dataclass(frozen=True)
class RigComparison:
    """A bench compared with its twin, on one scan."""

    prediction: Prediction  # of the twin
    crossed: Mapping[tuple[str, str], MeasuredFigures]  # by whose frames

    @property
    def measured(self) -> MeasuredFigures:
        return self.crossed["bench", "bench"]

    @property
    def outside(self) -> list[str]:
        """Figures of the bench that lie outside of their predicted interval."""
        return [
            name
            for name, value in self.measured.summary().items()
            if not self.prediction.figures[name].contains(value)
        ]

    def summary(self) -> dict[str, Any]:
        outside = self.outside
        return {
            "item": self.prediction.item,
            "figures": {
                name: {
                    "predicted": said.value,
                    "low": said.low,
                    "high": said.high,
                    "measured": value,
                    "inside": name not in outside,
                }
                for name, value in self.measured.summary().items()
                for said in [self.prediction.figures[name]]
            },
            "outside": outside,
            "crossed": {
                f"{frames}_by_{calibration}": figures.summary()
                for (frames, calibration), figures in self.crossed.items()
            },
        }


def compare_rigs(rig: Rig, session: Session, item: str, calibration: Calibration) -> RigComparison:
    """Confront a twin's prediction with a bench's scan, and cross their calibrations."""
    if not isinstance(rig.simulation, VirtualBench):
        raise ConfigError(f"{rig.source}: is no simulation that can predict; name a twin's rig file")
    check_devices(rig.camera.caps.size, rig.projector.caps, session)
    sampler, plan = rig.simulation.image_part_sampler(), session.plan
    mesh, depth = sampler.mesh(item), session.depth
    size, lattice = session.projector()
    rows, patterns = np.arange(rig.camera.caps.size[1]), make_patterns(plan, size, lattice)
    several = [rig.camera_settings(each, plan.bits) for each in plan.exposures]
    frames = [
        frame
        for k, (settings, images) in enumerate(zip(several, plan.passes, strict=True))
        for frame in sampler.frames(item, tuple(patterns[i] for i in images), settings, rows, k)
    ]
    bits, bayer = several[0].bits, rig.camera.caps.bayer
    raw = Recording(frames, plan, size, bits, f"the twin's {item}", lattice=lattice, bayer=bayer)
    own = merged_recording(raw, plan.exposures)
    calibrations = {"bench": calibration, "twin": sampler.calibration}
    crossed = {("bench", name): measured_figures(session, used, mesh) for name, used in calibrations.items()}
    crossed |= {
        ("twin", name): recorded_figures(own, used, mesh, depth) for name, used in calibrations.items()
    }
    return RigComparison(predict(rig, plan, item), crossed)
