"""Combine several calibrations of one rig, with what varies between them (random-effects meta-analysis).

Each calibration is the rig's mean, plus what the rig was like then, plus its own error. The rig varies by the
kinds of `fpplab.calibration.changes`, with one size for each part of the rig; the errors are those stated,
times a factor of 1 or more. Few calibrations do not determine these sizes, so every combination of a grid is
tried, and the results are averaged by their restricted likelihood (Bayesian model averaging): nothing counts
as constant only because few calibrations happen to agree. The combined covariance is that of the rig at any
time, so it contains what varies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.stats import chi2

from fpplab.calibration.board import FittedBoard, FittedErrors
from fpplab.calibration.changes import kinds_by_part
from fpplab.calibration.displacements import independent_modes
from fpplab.calibration.model import INTRINSICS, POSE, Calibration, CalibrationOrigin
from fpplab.characterisation.correction import with_parameters
from fpplab.characterisation.judging import CalibrationAsFitted
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.parameters import parameter_names
from fpplab.characterisation.working_volume import moved_points
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError, ConfigError

VARIATIONS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Sizes of what varies in one part of the rig, as multiples of those of `changed_rigs`, all equally probable:
turns by 0.001° to 0.3°, shifts by 0.01 to 3 mm. Chosen: less is below any stated uncertainty, more is another
rig."""

FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
"""Factors of the stated standard uncertainties, all equally probable. Chosen: evenly spaced in logarithm."""

UNITS = {"px": INTRINSICS[:4], "deg": POSE[:3], "mm": POSE[3:]}
"""Units of the parameters by their last names; those of distortion have none."""

DISTANCES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Distances of compared lengths in baselines; that counts at which both devices see most. Chosen."""


@dataclass(frozen=True)
class Varying:
    """A parameter or a length in several calibrations; all figures are standard deviations in its unit."""

    unit: str
    stated: float  # root mean square of what the calibrations state
    scatter: float  # of the calibrations
    between: float  # by which the rig varies
    combined: float  # of the combined calibration
    chance: float  # probability of a scatter as great as this if the calibrations state their errors rightly

    @property
    def exceeds(self) -> bool:
        """Whether the calibrations differ by more than they state."""
        return self.chance < USUAL_LIMITS.max_chance


@dataclass(frozen=True, eq=False)
class Combination:
    """The mean of several calibrations of one rig, with what varies between them."""

    calibration: Calibration
    factor: float  # root mean square of that of the stated standard uncertainties
    probabilities: dict[str, float]  # that each part of the rig varies
    quantities: dict[str, Varying]  # parameters, baseline, and lengths across what both devices see

    @property
    def varying(self) -> tuple[str, ...]:
        """Parameters and lengths that vary more than stated."""
        return tuple(name for name, quantity in self.quantities.items() if quantity.exceeds)

    def summary(self) -> dict[str, Any]:
        return {
            "factor": self.factor,
            "probabilities": self.probabilities,
            "varying": list(self.varying),
            "quantities": {name: vars(quantity) for name, quantity in self.quantities.items()},
        }


def combine(calibrations: Sequence[Calibration], sources: Sequence[str]) -> Combination:
    """Combine two or more calibrations of one rig; `sources` are their names for messages."""
    _require_one_rig(calibrations, sources)
    known = [CalibrationAsFitted.of(c, source) for c, source in zip(calibrations, sources, strict=True)]
    _require_equal("the distortion of {}", [k.level.value for k in known], sources)
    boards = [c.board for c in calibrations if c.board]
    has_one_board = all(board.target == boards[0].target for board in boards)
    stated = np.stack([_factor(k, not has_one_board) for k in known])
    values = np.stack([k.parameters() for k in known])
    names = parameter_names(known[0].level)
    parts = kinds_by_part(calibrations[0], names)
    grid = _Grid.of(values, stated, parts)
    if chi2.sf(grid.least_misfit, values[1:].size) < USUAL_LIMITS.max_chance:
        raise CalibrationError(
            f"{' and '.join(sources)}: differ by more than turns by {0.1 * VARIATIONS[-1]:g}°, shifts by "
            f"{VARIATIONS[-1]:g} mm and the like explain; combine calibrations of one rig"
        )
    mean, covariance, between = grid.average()
    first = replace(calibrations[0], board=_common_board(boards) if has_one_board else None)
    at = known[0].with_parameters(mean)
    longer = at.longer if has_one_board else np.zeros(len(mean))
    combined = with_parameters(first, at, covariance + np.outer(longer, longer))
    slopes = _quantities(combined, at, names)
    quantities = {
        name: _varying(unit, slope, values, stated, between, covariance)
        for name, (unit, slope) in slopes.items()
    }
    rms_px = {
        name: float(np.sqrt(np.mean([c.rms_px[name] ** 2 for c in calibrations])))
        for name in first.rms_px
        if all(name in c.rms_px for c in calibrations)
    }
    doubts = (f"{s}: {c.doubt}" for c, s in zip(calibrations, sources, strict=True) if c.doubt)
    combined = replace(combined, rms_px=rms_px, origin=_origin(calibrations), doubt="; ".join(doubts) or None)
    return Combination(combined, grid.factor, grid.probabilities(tuple(parts)), quantities)


def _require_one_rig(calibrations: Sequence[Calibration], sources: Sequence[str]) -> None:
    if len(calibrations) < 2:
        raise ConfigError("--combine needs two calibrations or more, of one rig")
    for device in ("camera", "projector"):
        lenses = [getattr(c, device) for c in calibrations]
        sizes = [f"{lens.size[0]} x {lens.size[1]} px, {lens.lattice}" for lens in lenses]
        _require_equal(f"the {device} of {{}}", sizes, sources)
        made = [getattr(c.origin, device) if c.origin else None for c in calibrations]
        _require_equal(
            f"the {device} of {{}}", [m.description if m and m.serial else None for m in made], sources
        )
        _require_equal(
            f"the first pixel of the {device} of {{}}", [m.offset_px if m else None for m in made], sources
        )
    stages = [c.origin.stage_mm if c.origin else None for c in calibrations]
    _require_equal("the stage in mm of {}", stages, sources)
    for (a, first), (b, second) in combinations(zip(sources, calibrations, strict=True), 2):
        if np.array_equal(first.camera.matrix, second.camera.matrix):
            raise ConfigError(f"{b}: is the calibration {a} again; give each once")


def _require_equal(what: str, stated: Sequence[object], sources: Sequence[str]) -> None:
    """Refuse values that differ where they are known."""
    known = [(source, value) for source, value in zip(sources, stated, strict=True) if value is not None]
    for source, value in known[1:]:
        if value != known[0][1]:
            raise CalibrationError(
                f"{what.format(source)} is {value}, but that of {known[0][0]} is {known[0][1]}; combine "
                "calibrations of one rig, characterised in the same way"
            )


def _factor(known: CalibrationAsFitted, with_scale: bool) -> Floats:
    """Factor (n, n + 1) of the covariance."""
    return np.column_stack([known.factor, with_scale * known.longer])


def _common_board(boards: Sequence[FittedBoard]) -> FittedBoard:
    """The board's mean shape, with root mean square errors."""
    errors = [board.errors for board in boards]
    poses = [e.poses for e in errors if e.poses is not None]
    sizes = {
        name: float(np.sqrt(np.mean([getattr(e, name) ** 2 for e in errors])))
        for name in FittedErrors.model_fields
        if name != "poses"
    }
    freedom = sum(poses) - len(poses) if len(poses) == len(errors) else None
    points = np.mean([board.points for board in boards], axis=0)
    merged = FittedErrors.model_validate({**sizes, "poses": freedom and freedom + 1})
    return replace(boards[0], points=points, errors=merged)


def _origin(calibrations: Sequence[Calibration]) -> CalibrationOrigin:
    """Made now; verified when the last of them was."""
    origins = [c.origin for c in calibrations if c.origin]
    more = {
        name: next((value for o in origins if (value := getattr(o, name)) is not None), None)
        for name in ("camera", "projector", "stage_mm")
    }
    taken = [o.verified for o in origins if o.verified]
    return CalibrationOrigin.now(poses_taken=max(taken, default=None), **more)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Estimates for G combinations of a factor and of sizes of what varies, with n parameters."""

    sizes: Floats  # (G, 1 + parts): the factor, then the parts of the rig
    weights: Floats  # (G,)
    means: Floats  # (G, n)
    covariances: Floats  # (G, n, n), of the means
    between: Floats  # (parts, n, n), for a size of 1
    least_misfit: float  # χ² with the greatest of all sizes

    @classmethod
    def of(cls, values: Floats, factors: Floats, parts: dict[str, Floats]) -> _Grid:
        # values (K, n); factors (K, n, m) of the stated covariances; parts (n, kinds)
        # By square roots: what varies is up to 1e5 times what is stated, and its square loses all digits.
        modes, inverse = independent_modes(np.mean(factors @ np.swapaxes(factors, 1, 2), axis=0))
        stated, kinds = inverse @ factors, [inverse @ own for own in parts.values()]
        varied = np.array(list(product(VARIATIONS, repeat=len(parts))))
        added = np.concatenate(
            [v[:, None, None] * own.T for v, own in zip(varied.T, kinds, strict=True)], axis=1
        )
        x, likelihoods, means, covariances = values @ inverse.T, [], [], []
        for factor in FACTORS:
            of_all = [
                np.concatenate([np.broadcast_to(factor * own.T, (len(varied), *own.T.shape)), added], axis=1)
                for own in stated
            ]
            spread = np.linalg.qr(np.stack(of_all, axis=1), mode="r")
            whitener = np.swapaxes(np.linalg.inv(spread), 2, 3)
            whitened = np.einsum("gkij,kj->gki", whitener, x).reshape(len(varied), -1, 1)
            q, r = np.linalg.qr(whitener.reshape(len(varied), -1, x.shape[1]))
            root, along = np.linalg.inv(r), np.swapaxes(q, 1, 2) @ whitened
            misfit = np.sum((whitened - q @ along) ** 2, axis=(1, 2))
            logarithms = [np.log(np.abs(np.diagonal(m, axis1=-2, axis2=-1))) for m in (whitener, r)]
            likelihoods.append(logarithms[0].sum(axis=(1, 2)) - logarithms[1].sum(axis=1) - 0.5 * misfit)
            mean, covariance = (root @ along)[..., 0], root @ np.swapaxes(root, 1, 2)
            means.append(mean @ modes.T)
            covariances.append(modes @ covariance @ modes.T)
        weights = np.exp(np.concatenate(likelihoods) - np.max(likelihoods))
        return cls(
            np.column_stack([np.repeat(FACTORS, len(varied)), np.tile(varied, (len(FACTORS), 1))]),
            weights / weights.sum(),
            np.concatenate(means),
            np.concatenate(covariances),
            np.stack([kinds @ kinds.T for kinds in parts.values()]),
            float(misfit[-1]),
        )

    @property
    def factor(self) -> float:
        return float(np.sqrt(self.weights @ self.sizes[:, 0] ** 2))

    def probabilities(self, parts: Sequence[str]) -> dict[str, float]:
        return {part: float(self.weights @ (self.sizes[:, 1 + k] > 0)) for k, part in enumerate(parts)}

    def average(self) -> tuple[Floats, Floats, Floats]:
        """Mean (n,), its covariance (n, n) for the rig at any time, and the part of that which varies."""
        mean = self.weights @ self.means
        off = self.means - mean
        between = np.tensordot(self.weights @ self.sizes[:, 1:] ** 2, self.between, 1)
        of_mean = np.tensordot(self.weights, self.covariances, 1) + (self.weights * off.T) @ off
        return mean, of_mean + between, between


def _quantities(
    calibration: Calibration, at: CalibrationAsFitted, names: Sequence[str]
) -> dict[str, tuple[str, Floats]]:
    """Units, and derivatives (n,) by the parameters."""
    quantities = {}
    for name, row in zip(names, np.eye(len(names)), strict=True):
        term = name.rpartition(".")[2]
        unit = next((unit for unit, terms in UNITS.items() if term in terms), "")
        quantities[name] = unit, np.degrees(row) if unit == "deg" else row
    translation = calibration.T_projector_camera.translation
    baseline = np.append(np.zeros(len(names) - 3), translation / calibration.baseline_mm)
    quantities["baseline"] = "mm", baseline
    places = _seen_places(calibration)
    if places is not None:
        moved = moved_points(at.devices, at.level, places).reshape(len(places), 3, -1)
        for name, start, end in (("width", 0, 1), ("height", 2, 3), ("depth", 4, 5)):
            apart = places[end] - places[start]
            length = float(np.linalg.norm(apart))
            quantities[f"{name} of {length:.0f} mm"] = "mm", apart / length @ (moved[end] - moved[start])
    return quantities


def _seen_places(calibration: Calibration) -> Floats | None:
    """Ends (6, 3) of a width, a height and a depth, in mm; None where the devices see nothing in common."""
    width, height = calibration.camera.size
    u, v = np.meshgrid(np.linspace(0, width - 1, 17), np.linspace(0, height - 1, 13))
    slopes = calibration.camera.normalise(np.stack([u, v], axis=-1).reshape(-1, 2))
    rays = np.column_stack([slopes, np.ones(len(slopes))])[np.isfinite(slopes).all(axis=1)]
    visible = [
        places[calibration.projector.sees(places, calibration.T_projector_camera)]
        for places in (factor * calibration.baseline_mm * rays for factor in DISTANCES)
    ]
    most = max(visible, key=len)
    if len(most) < 2:
        return None
    ends = [most[pick(most[:, axis])] for axis in (0, 1) for pick in (np.argmin, np.argmax)]
    middle = most[np.argmin(np.sum((most - most.mean(axis=0)) ** 2, axis=1))]
    return np.asarray(np.stack([*ends, 0.95 * middle, 1.05 * middle]))


def _varying(
    unit: str, slope: Floats, values: Floats, stated: Floats, between: Floats, covariance: Floats
) -> Varying:
    projected, variances = values @ slope, np.sum((slope @ stated) ** 2, axis=1)
    mean = np.average(projected, weights=1.0 / variances)
    misfit = float(np.sum((projected - mean) ** 2 / variances))
    return Varying(
        unit,
        float(np.sqrt(variances.mean())),
        float(projected.std(ddof=1)),
        float(np.sqrt(slope @ between @ slope)),
        float(np.sqrt(slope @ covariance @ slope)),
        float(chi2.sf(misfit, len(projected) - 1)),
    )
