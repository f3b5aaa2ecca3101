"""A cause of what is wrong, and a finding: one thing that is wrong with a rig or a scan."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from fpplab.diagnosis.evidence import Evidence, Needs

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure
else:
    Figure = Any  # for the modules of causes: Matplotlib is loaded only where a picture is drawn


class DetectionStage(IntEnum):
    """What is looked at, in this order; a cause may make the figures of later stages meaningless."""

    VISIBILITY = 0  # whether there are fringes at all
    COLOUR = 1  # whether frames of all colours are as bright
    FRAMES = 2  # light, response and motion, which take equal frames for granted
    BLUR = 3  # contrast of fringes and edges
    PLAN = 4  # whether the plan describes the images
    REFLECTIONS = 5  # the direction in which the coordinate runs, which a plan has to be right for
    POINTS = 6  # the geometry of the points


@dataclass(frozen=True)
class Detector:
    """A function that looks for a cause."""

    stage: DetectionStage
    find: Callable[[Evidence, Sequence[Finding]], Iterable[Finding]]  # given what was found before
    replaces: bool = False  # whether what it finds replaces earlier findings of its cause


@dataclass(frozen=True)
class Picture:
    """A figure that shows a cause."""

    needs: Needs  # what has to be known for it
    draw: Callable[[Evidence, Finding], Figure | None]  # None where there is nothing to draw


@dataclass(frozen=True)
class FaultCause:
    """What may be wrong, what to do about it, and how it is found and shown.

    Causes are equal by their key; the rest is text and functions of the module that defines the cause.
    """

    key: str  # a short name, which files and --json contain
    meaning: str = field(compare=False)  # one sentence
    remedy: str = field(compare=False)  # what to do
    measured: str = field(compare=False)  # what is measured, for the documentation
    limit: str = field(compare=False)  # from which value on it is reported, for the documentation
    seen_in: str = field(compare=False)  # which commands or data show it, for the documentation
    detectors: tuple[Detector, ...] = field(default=(), compare=False)
    picture: Picture | None = field(default=None, compare=False)
    shown_by: str = field(default="", compare=False)  # what shows it where it has no picture
    side_effects: frozenset[str] = field(default=frozenset(), compare=False)  # causes it may bring about
    # Causes of which each leaves something in the other's figure, and the ratio of this one's excess to the
    # other's above which this one is the cause.
    outweighs_from: Mapping[str, float] = field(default_factory=dict, compare=False)
    invalidates: frozenset[DetectionStage] = field(
        default=frozenset(), compare=False
    )  # stages that it makes meaningless
    useless_from: float = field(default=math.inf, compare=False)  # excess that makes a result useless
    useless_if_first_from: float = field(default=math.inf, compare=False)  # the same if nothing explains it

    def __str__(self) -> str:
        return self.key


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a rig or a scan."""

    cause: FaultCause  # what is wrong
    evidence: str  # how it shows, with the measured value and its limit
    excess: float  # measured value over its limit, 1 or more, by which findings are ranked
    advice: str | None = None  # what to do in this very case; by default the remedy of the cause
    factor: float | None = None  # by which to multiply the plan's exposure
    ruins_points: bool = False  # whether the points must not be used
    behind: FaultCause | None = None  # a cause that was found too and may be all that shows here

    @property
    def sentence(self) -> str:
        return f"{self.cause}: {self.evidence}"

    @property
    def remedy(self) -> str:
        text = self.advice or self.cause.remedy
        if self.behind:
            text = f"see to {self.behind} first, which may be all that shows here; if this remains, {text}"
        return f"{text}; multiply exposure_s by {self.factor:.2g}" if self.factor else text

    def summary(self) -> dict[str, str]:
        return {"cause": self.cause.key, "evidence": self.evidence, "remedy": self.remedy}
