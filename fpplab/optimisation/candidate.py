"""Candidates of a search, the scores that measuring them gives, and the interface of what measures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Protocol

from fpplab.core.conventions import Axis
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class Fringes:
    """One fringe set of a candidate.

    Attributes
    ----------
    axis : Axis
        Direction along which the phase grows.
    stripes : float
        Number of periods across the projector.
    steps : int
        Number of phase-shifted images.
    """

    axis: Axis
    stripes: float
    steps: int


@dataclass(frozen=True)
class Candidate:
    """One arrangement that a search can try.

    Attributes
    ----------
    fringes : tuple of Fringes
        Fringe sets, the base first.
    exposure_s : float
        Exposure of every image in seconds.
    stage_mm : float or None
        Position of the stage that moves a device, which sets the baseline; None leaves it.
    convergence_deg : float or None
        Rotation of the projector towards the camera in degrees, relative to its given orientation; None
        leaves it. Only a simulation can do this.
    """

    fringes: tuple[Fringes, ...]
    exposure_s: float
    stage_mm: float | None = None
    convergence_deg: float | None = None

    @property
    def images(self) -> int:
        """How many images a measurement takes."""
        return sum(one.steps for one in self.fringes)

    def plan(self, template: Plan) -> Plan:
        """Make the plan that projects this candidate.

        Parameters
        ----------
        template : Plan
            Plan from which everything but fringes, exposure and stage position is taken.

        Returns
        -------
        Plan
            The candidate's plan.
        """
        sets = tuple(Sinusoid(**asdict(one)) for one in self.fringes)
        changed = {"fringes": sets, "exposure_s": self.exposure_s, "stage_mm": self.stage_mm}
        return template.model_copy(update=changed)


@dataclass(frozen=True)
class Accuracy:
    """Deviation of a measurement from the true shape, as `fpplab.comparison` defines it.

    Attributes
    ----------
    points : int
        Measured points that lie on the shape.
    surface_smcd_um : float
        Symmetric mean distance between points and true surface in µm.
    smcd_um : float
        Symmetric mean Chamfer distance between measured and sampled true points in µm.
    smcd_floor_um : float
        What a perfect measurement would have for `smcd_um`, in µm.
    surface_rms_um : float
        Root mean square distance of the points from the true surface in µm.
    completeness : float
        Share of the true surface that has a measured point nearby, 0 … 1.
    wrong_orders : float
        Share of points whose projector coordinate is off by half a period of the finest set or more, 0 … 1.
    outliers : float
        Share of points that the outlier filter removed, 0 … 1.
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
    """The result of measuring one artefact once with one candidate.

    Attributes
    ----------
    artefact : str
        Name of the artefact.
    seed : int
        Seed of the noise on a simulation, number of the repeat on a real rig.
    images : int
        Images that the measurement took.
    seconds : float
        Acquisition time on the projector and camera, from the exposure and their stated dead times.
    """

    artefact: str
    seed: int
    images: int
    seconds: float


class Evaluator(Protocol):
    """Interface of what measures candidates, on whatever rig.

    A worker opens one with an `EvaluatorFactory`, calls `measure` for one candidate after another,
    and `close` at the end.
    """

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        """Measure every artefact of the study with one candidate.

        Equal arguments must give equal scores where the rig is a simulation.

        Parameters
        ----------
        candidate : Candidate
            What to measure with.
        seed : int
            Seed of the noise on a simulation; on a real rig another seed is another repeat.

        Returns
        -------
        tuple of Score
            One for each artefact.

        Raises
        ------
        DataError, CalibrationError
            The candidate cannot be measured, which the search takes as its result and goes on.
        FppError
            Any other fault, which is the rig's and ends the search.
        """
        ...

    def close(self) -> None:
        """Close the rig. Called once, also after `measure` has failed."""
        ...
