"""Correct a calibration by few poses of its board, for what has changed since it was made.

The calibration's parameters are known to be x with covariance C; a change adds multiples of the kinds of
`fpplab.calibration.changes`, each with a standard deviation beyond what happens unnoticed. The residuals of a
pose, less what its own six parameters take up, are then linear in errors of the calibration, in those that
all points of the pose share, and in the change, all normal: Bayes' rule gives them with their covariance. Few
poses do not tell all kinds apart, and most of what can change did not. So every combination of places and
lenses that may have changed is tried, and the results are averaged by their probability (Bayesian model
averaging); where several fit, their differences are part of the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from fpplab.calibration.changes import changes_by_part, kinds_by_part
from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.characterisation.judging import CalibrationAsFitted, Judgement, judge
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import parameter_names
from fpplab.characterisation.pose_effects import effects_of_pose
from fpplab.characterisation.zhang import matrix_of, transform
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole

PRIOR_FACTORS = (0.3, 1.0, 3.0, 10.0)
"""Standard deviations of a change before anything is seen of it, as multiples of the sizes of `changed_rigs`,
all equally probable: turns by 0.03° to 1°, shifts by 0.3 to 10 mm. Chosen: beyond, it is another rig."""

ITERATIONS = 4
"""Times the residuals are linearised. Chosen: each squares the relative error of the change."""


@dataclass(frozen=True, eq=False)
class Correction:
    """A calibration as few poses of its board have it now."""

    calibration: Calibration
    probabilities: dict[str, float]  # that each part of the rig has changed
    before: Judgement  # of the calibration as it was, by these poses
    after: Judgement  # of the corrected one

    @property
    def untold(self) -> tuple[str, ...]:
        """What these poses leave open: it has changed with a probability of 5 to 95 %."""
        return tuple(name for name, chance in self.probabilities.items() if 0.05 < chance < 0.95)

    def summary(self) -> dict[str, Any]:
        return {
            "needed": self.before.contradicted,
            "probabilities": self.probabilities,
            "untold": list(self.untold),
            "before": self.before.summary(),
            "after": self.after.summary(),
        }


def correct(
    calibration: Calibration,
    observations: Sequence[Observation],
    left_out: dict[str, str] | None = None,
    source: str = "the calibration",
) -> Correction:
    """Correct a calibration by poses of its board that were taken after a change."""
    before = judge(calibration, observations, left_out, source)
    known = CalibrationAsFitted.of(calibration, source)
    change = estimate_change(calibration, known, observations)
    at = known.with_parameters(change.parameters)
    corrected = with_parameters(calibration, at, change.covariance + np.outer(at.longer, at.longer))
    after = judge(corrected, observations, left_out, source)
    if after.contradicted:
        raise CalibrationError(
            f"{source}: no change of place, lenses or pictures explains these poses ({after.verdict})"
        )
    return Correction(corrected, change.probabilities, before, after)


@dataclass(frozen=True, eq=False)
class ChangeEstimate:
    """What is known of the parameters after a change that poses have shown."""

    parameters: Floats  # (n,) as now expected
    covariance: Floats  # (n, n), without the board's scale
    probabilities: dict[str, float]  # that each part of the rig has changed


def estimate_change(
    calibration: Calibration, known: CalibrationAsFitted, observations: Sequence[Observation]
) -> ChangeEstimate:
    """Estimate by Bayes' rule what has changed, from poses of what `known` has as its board."""
    hypotheses = _hypotheses(calibration, known)
    stated = mean = known.parameters()
    for _ in range(ITERATIONS):
        residuals = _linearised(known.with_parameters(mean), mean - stated, observations)
        fits = [residuals.fit(known.factor, kinds) for _, kinds in hypotheses]
        evidence = np.array([fit.log_evidence for fit in fits])
        weights = np.exp(evidence - evidence.max())
        weights /= weights.sum()
        mean = stated + np.average([fit.change for fit in fits], axis=0, weights=weights)
    spread = [fit.change - (mean - stated) for fit in fits]
    each = [fit.covariance + np.outer(off, off) for fit, off in zip(fits, spread, strict=True)]
    probabilities = {
        name: float(sum(w for w, (names, _) in zip(weights, hypotheses, strict=True) if name in names))
        for name in changes_by_part(calibration)
    }
    return ChangeEstimate(mean, np.average(each, axis=0, weights=weights), probabilities)


def _hypotheses(calibration: Calibration, known: CalibrationAsFitted) -> list[tuple[tuple[str, ...], Floats]]:
    """List what may have changed, with the changes (n, kinds) of the parameters that it means."""
    names_of_parameters = parameter_names(known.level)
    parts = kinds_by_part(calibration, names_of_parameters)
    hypotheses: list[tuple[tuple[str, ...], Floats]] = [((), np.zeros((len(names_of_parameters), 0)))]
    for count in range(1, len(parts) + 1):
        for names in combinations(parts, count):
            kinds = np.hstack([parts[name] for name in names])
            hypotheses += [(names, factor * kinds) for factor in PRIOR_FACTORS]
    return hypotheses


def with_parameters(calibration: Calibration, known: CalibrationAsFitted, covariance: Floats) -> Calibration:
    """Replace a calibration's parameters and their covariance, the board's scale included."""
    devices, pair = known.devices, known.devices.T_projector_camera
    camera, projector = (
        Pinhole(old.size, matrix_of(lens), lens[4:], old.lattice)
        for old, lens in ((calibration.camera, devices.camera), (calibration.projector, devices.projector))
    )
    uncertainty = Uncertainty(parameter_names(known.level), 0.5 * (covariance + covariance.T))
    return replace(
        calibration,
        camera=camera,
        projector=projector,
        T_projector_camera=transform(pair),
        uncertainty=uncertainty,
        marks=None,  # which were seen before the change
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """The change of the parameters under one hypothesis."""

    log_evidence: float
    change: Floats  # (n,)
    covariance: Floats  # (n, n), without the board's scale


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Whitened residuals of all poses, less what the poses take up, linear in errors of unit variance.

    All that Bayes' rule needs of them is the triangle R of a QR decomposition of their columns: the residuals
    for the parameters as stated, their derivatives by errors that the points of one pose share, and those by
    the parameters. Their products, squares of great numbers, would not be exact enough.
    """

    triangle: Floats  # (1 + E + n, 1 + E + n)

    def fit(self, calibration_error: Floats, kinds: Floats) -> _Fit:
        """Apply Bayes' rule where the parameters are off by an error of the calibration and by a change."""
        modes = np.hstack([calibration_error, kinds])
        errors = block_diag(np.eye(self.triangle.shape[1] - 1 - len(modes)), modes)
        count, shape = modes.shape[1], errors.shape[1]
        design = np.vstack([self.triangle[:, 1:] @ errors, np.eye(shape)])
        observed = np.append(self.triangle[:, 0], np.zeros(shape))
        orthogonal, root = np.linalg.qr(design)
        explained = orthogonal.T @ observed
        inverse = solve_triangular(root, np.eye(shape))[-count:]
        half_logarithm = float(np.sum(np.log(np.abs(np.diag(root)))))
        evidence = -0.5 * float(observed @ observed - explained @ explained) - half_logarithm
        changed = modes @ inverse
        return _Fit(evidence, changed @ explained, changed @ changed.T)


def _linearised(at: CalibrationAsFitted, moved: Floats, observations: Sequence[Observation]) -> _Residuals:
    """Linearise the residuals about parameters that have moved from those stated."""
    n, count = len(moved), len(observations)
    shared = at.shared
    parts: list[Floats] = []
    for index, observation in enumerate(observations):
        problem, here = at.problem(observation, at.pose(observation))
        _, slopes, _ = problem.slopes(0, here)
        taken_up, _ = np.linalg.qr(slopes[:, n : n + 6])
        effects = np.zeros((len(slopes), count, len(shared)))
        effects[:, index] = effects_of_pose(problem, 0, here) * shared
        observed = slopes[:, :n] @ moved - problem.weighted_residuals(0, here, np.inf)[0]
        part = np.column_stack([observed, effects.reshape(len(slopes), -1), slopes[:, :n]])
        parts.append(part - taken_up @ (taken_up.T @ part))
    return _Residuals(np.asarray(np.linalg.qr(np.vstack(parts), "r")))
