"""The words of a search: an arrangement to try, what measuring it gave, and who measures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Protocol

from fpplab.core.conventions import Axis
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class Fringes:
    """One fringe set: `steps` images of `stripes` periods along `axis`."""

    axis: Axis
    stripes: float
    steps: int


@dataclass(frozen=True)
class Candidate:
    """One arrangement to try.

    fringes: base first. stage_mm: where the stage puts the device that moves, which is the baseline; None
    leaves it. convergence_deg: turn of the projector towards the camera, in degrees, from how it stands;
    only a twin can.
    """

    fringes: tuple[Fringes, ...]
    exposure_s: float
    stage_mm: float | None = None
    convergence_deg: float | None = None

    @property
    def images(self) -> int:
        """How many images a measurement takes."""
        return sum(one.steps for one in self.fringes)

    def plan(self, like: Plan) -> Plan:
        """The plan that projects it, in all else like `like`."""
        sets = tuple(Sinusoid(**asdict(one)) for one in self.fringes)
        changed = {"fringes": sets, "exposure_s": self.exposure_s, "stage_mm": self.stage_mm}
        return like.model_copy(update=changed)


@dataclass(frozen=True)
class Accuracy:
    """How far a measurement is from the true shape.

    Distances in µm; `completeness`, `wrong_orders` (points off by a fringe or more) and `outliers` (removed
    by the filter) are shares.
    """

    points: int
    surface_smcd_um: float
    smcd_um: float
    smcd_floor_um: float
    surface_rms_um: float
    completeness: float
    wrong_orders: float
    outliers: float


@dataclass(frozen=True)
class Score(Accuracy):
    """One artefact measured once. seconds: acquisition time on the real projector and camera."""

    artefact: str
    seed: int
    images: int
    seconds: float


class Evaluator(Protocol):
    """Measures candidates, on whatever rig."""

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        """One score for each artefact of the study."""
        ...

    def close(self) -> None:
        """Let go of the rig."""
        ...
