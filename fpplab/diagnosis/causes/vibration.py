"""The scene moved between the fringe sets."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.core.drawing import ACCENT, ALARM, ERROR_COLOURS, colour_bar, side_by_side
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.sample import FrameSample


class VibrationLimits(LimitsSection):
    """How far the scene may move between fringe sets."""

    max_shift_px: Positive = 0.08
    """Displacement in camera px. Measured on benches: those at rest stay below."""
    min_sigmas: Positive = 8.0
    """The same as a multiple of its standard uncertainty. Measured on benches."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    limits = evidence.limits.of(VibrationLimits)
    moved = displacements_px(evidence.frames)
    certain = [shift if shift > limits.min_sigmas * sigma else 0.0 for shift, sigma in moved]
    worst = max(certain, default=0.0)
    if worst > limits.max_shift_px:
        text = (
            f"the scene moved by {worst:.2f} px between fringe sets 1 and {certain.index(worst) + 2} "
            f"(at most {limits.max_shift_px:g} px)"
        )
        yield Finding(VIBRATION, text, worst / limits.max_shift_px)


def displacements_px(sample: FrameSample) -> list[tuple[float, float]]:
    """Measure how far the scene is displaced in each fringe set compared with the first."""
    first, *others = sample.offsets_in_tiles
    return [_displacement(first, other) for other in others]


def _displacement(reference: Floats, other: Floats) -> tuple[float, float]:
    """Displacement in px between pictures (T, rows, columns), and its uncertainty, by least squares."""
    v, u = (np.gradient(reference, axis=k)[:, 1:-1, 1:-1] for k in (1, 2))
    inner, change = reference[:, 1:-1, 1:-1], (other - reference)[:, 1:-1, 1:-1]
    basis = np.stack([u.ravel(), v.ravel(), inner.ravel(), np.ones(inner.size)], axis=1)
    normal = basis.T @ basis + 1e-9 * np.eye(4)
    best = np.linalg.solve(normal, basis.T @ change.ravel())
    residuals = change.ravel() - basis @ best
    covariance = np.linalg.inv(normal)[:2, :2] * residuals.var()
    return float(np.hypot(*best[:2])), float(np.sqrt(np.trace(covariance)))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    sample, limit = evidence.frames, evidence.limits.of(VibrationLimits).max_shift_px
    moved = [shift for shift, _ in displacements_px(sample)]
    worst = int(np.argmax(moved))
    change = (sample.offsets_in_tiles[worst + 1] - sample.offsets_in_tiles[0])[0]
    figure, (left, right) = side_by_side(3.0, (1.0, 1.4))
    max_change = max(float(np.abs(change).max()), 1.0)
    shown = left.imshow(change, cmap=ERROR_COLOURS, vmin=-max_change, vmax=max_change)
    colour_bar(figure, left, shown, f"set {worst + 2} − set 1, grey levels")
    left.set(xlabel="px", ylabel="px")
    sets = np.arange(2, len(moved) + 2)
    right.bar(sets, moved, color=ACCENT, width=0.6)
    right.axhline(limit, color=ALARM, linewidth=1.2, label=f"limit {limit:g} px")
    right.set(xlabel="fringe set", ylabel="displacement from set 1 in px", xticks=sets)
    right.legend(loc="best")
    return figure


VIBRATION = FaultCause(
    key="vibration",
    meaning="The scene moved between the fringe sets.",
    remedy="fix the part, avoid motion of stage, fans and people, and use triggered frames",
    measured="displacement between the mean images of the fringe sets",
    limit=f"{VibrationLimits().max_shift_px:g} px, and "
    f"{VibrationLimits().min_sigmas:g} standard uncertainties",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"interreflection", "wrong_resolution", "stale_calibration"}),
    # Unequal frames feign a motion of 0.05 to 0.12 px, an eighth of their excess; motion over fine fringes
    # makes sets of three images look unequal by up to three times its own.
    outweighs_from={"bands": 0.25, "flicker": 0.25},
)
