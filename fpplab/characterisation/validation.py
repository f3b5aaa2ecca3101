"""Calibrations from fewer poses compared with what the covariance predicts, to test the stated uncertainty.

Leaving out each pose in turn (jackknife) and fitting the two halves of the poses (as mrcal's documentation
does) changes the result. How much it should change follows from the covariances: what is estimated from some
of the data differs from the estimate from all by the difference of their covariances (J. Hausman,
"Specification tests in econometrics", 1978), and two halves by the sum.

Every refit starts from the whole fit, and estimates the sizes of the errors anew. The jackknife knows nothing
of the errors' model, but with n poses it has n - 1 degrees of freedom for two dozen parameters, so that by
chance alone it exceeds what is expected many times in some directions. Of modes in which that is one, the
eigenvalues follow the distribution of Marchenko and Pastur. What exceeds the edge of that distribution is
added to the covariance, as a share of it, less the part that is chance (D. Donoho, M. Gavish and
I. Johnstone, "Optimal shrinkage of eigenvalues in the spiked covariance model", 2018, Frobenius norm).
A pose that alone determines something changes it by more than the uncertainty of all: with many poses that is
expected; few may each hide errors outside the model, and are compared with the covariance itself.

Besides focal lengths and baseline, the points that the devices measure are compared: by how much they are
moved in space (place), and by how much their form changes, all rigid motion removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from fpplab.calibration.displacements import independent_modes
from fpplab.calibration.model import INTRINSICS, Calibration
from fpplab.characterisation.bundle import adjust_bundle, estimate_uncertainty
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ErrorSizes, Model, Solution, project_with_derivatives
from fpplab.characterisation.problem import without_poses
from fpplab.characterisation.working_volume import moved_points, without_motion
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform

MANY_POSES = 8
"""Poses of which each half determines a fit by itself. Derived: it has four or more."""

_Fit = tuple[Sequence[Observation], Solution, Model, ErrorSizes]


@dataclass(frozen=True)
class Repeat:
    """A quantity in calibrations from fewer poses."""

    quantity: str  # such as `camera.fx`, `baseline`, `place` or `form`
    unit: str  # of all figures
    modelled: float  # standard uncertainty by the sizes of the errors
    stated: float  # that which the calibration states: `modelled`, and what the jackknife adds
    changed: float  # how much the quantity changes
    predicted: float  # the same, as the covariances predict it
    chance: float  # probability of changes as great as these if the prediction is right, about

    @property
    def ratio(self) -> float:
        """Actual over predicted change."""
        return self.changed / self.predicted


@dataclass(frozen=True, eq=False)
class Validation:
    """The stated uncertainty, put to the test."""

    covariance: Floats  # (n, n) of the devices with what the jackknife adds, without the board's scale
    jackknife: tuple[Repeat, ...]  # each pose left out in turn
    halves: tuple[Repeat, ...] = ()  # every other pose compared with the rest; empty with fewer than 8 poses
    max_chance: float = USUAL_LIMITS.max_chance  # probability below which an uncertainty is too small

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on uncertainties that are too small."""
        return tuple(
            f"{how} changes the {_NAMES[repeat.quantity]} {repeat.ratio:.1f} times as much as predicted: the "
            "sizes of the errors do not explain it; look for a pose in which something moved, or take more "
            "poses"
            for how, repeats in (("leaving poses out", self.jackknife), ("halving the poses", self.halves))
            for repeat in repeats
            if repeat.chance < self.max_chance
        )


_NAMES = {
    "camera.fx": "camera's focal length",
    "projector.fx": "projector's focal length",
    "baseline": "baseline",
    "place": "place of what is measured",
    "form": "form of what is measured",
}


def compare_with_fewer_poses(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes,
    without: Sequence[Solution],
) -> Validation:  # fmt: skip
    """Compare calibrations from fewer poses with what the covariance of all predicts."""
    whole: _Fit = (observations, best, model, sizes)
    quantities = _quantities(whole)
    covariance, count = _covariance(whole), len(observations)
    changes, spreads = [], []
    for index, near in enumerate(without):
        others = [o for k, o in enumerate(observations) if k != index]
        changes.append(_devices(near, model) - _devices(best, model))
        spreads.append(_covariance((others, near, model, sizes)) - covariance)
    share = (count - 1) / count
    around = np.array(changes) - np.mean(changes, axis=0)
    changed, predicted = share * around.T @ around, share * np.sum(spreads, axis=0)
    expected = predicted if count >= MANY_POSES else covariance
    stated = covariance + beyond_chance(covariance, changed, count - 1, expected)
    jackknife = tuple(
        _judge_repeated_fits(quantity, (covariance, stated), changed, predicted, count - 1)
        for quantity in quantities
    )
    halves = _repeat_with_halves(whole, quantities, (covariance, stated))
    return Validation(stated, jackknife, halves, model.limits.max_chance)


def beyond_chance(covariance: Floats, repeated: Floats, freedom: int, expected: Floats) -> Floats:
    """Compute what a covariance lacks where few repeats exceed beyond chance what it lets expect of them."""
    # covariance (n, n); repeated (n, n), with so many degrees of freedom; expected (n, n), at least the
    # covariance; returns (n, n)
    modes, inverse = independent_modes(covariance)
    sizes, turned = np.linalg.eigh(inverse @ expected @ inverse.T)
    scaled = turned * np.sqrt(np.maximum(sizes, 1.0))
    whitening = np.linalg.inv(scaled) @ inverse
    values, directions = np.linalg.eigh(whitening @ repeated @ whitening.T)
    aspect = len(values) / freedom
    clear = values > (1.0 + np.sqrt(aspect)) ** 2
    sampled, along = values[clear], scaled @ directions[:, clear]
    along = modes @ (along / np.linalg.norm(along, axis=0))
    centred = sampled + 1.0 - aspect
    true = 0.5 * (centred + np.sqrt(centred**2 - 4.0 * sampled)) - 1.0
    cosine = (1.0 - aspect / true**2) / (1.0 + aspect / true)
    return np.asarray((along * true * cosine) @ along.T)


@dataclass(frozen=True, eq=False)
class _Quantity:
    """Derivatives (m, n) of a quantity; `scale` times the sum of its squares counts."""

    name: str
    unit: str
    slopes: Floats
    scale: float = 1.0

    def size(self, square: Floats) -> float:
        """Root mean square of the quantity for a matrix (n, n) of squares of the parameters."""
        total = float(np.einsum("mi,ij,mj->", self.slopes, square, self.slopes))
        return float(np.sqrt(max(total * self.scale, 1e-24)))

    def freedom(self, square: Floats) -> float:
        """Effective number of independent components for such a matrix."""
        spread = self.slopes @ square @ self.slopes.T
        return float(np.trace(spread) ** 2 / np.sum(spread**2))


def _judge_repeated_fits(
    quantity: _Quantity, both: tuple[Floats, Floats], changed: Floats, predicted: Floats, repeats: int
) -> Repeat:
    # both (n, n): the covariance by the sizes of the errors, and that stated
    was, expected = quantity.size(changed), quantity.size(predicted)
    freedom = repeats * quantity.freedom(predicted)
    chance = float(chi2.sf(freedom * (was / expected) ** 2, freedom))
    modelled, stated = map(quantity.size, both)
    return Repeat(quantity.name, quantity.unit, modelled, stated, was, expected, chance)


def _repeat_with_halves(
    whole: _Fit, quantities: Sequence[_Quantity], both: tuple[Floats, Floats]
) -> tuple[Repeat, ...]:
    observations, best, model, sizes = whole
    if len(observations) < MANY_POSES:
        return ()
    devices, spread = [], []
    for first in (0, 1):
        chosen = np.arange(first, len(observations), 2)
        start = without_poses(best, np.setdiff1d(np.arange(len(observations)), chosen).tolist())
        half = [observations[k] for k in chosen]
        solution, _ = adjust_bundle(half, start, model, sizes)
        devices.append(_devices(solution, model))
        spread.append(_covariance((half, solution, model, sizes)))
    change = devices[1] - devices[0]
    return tuple(
        _judge_repeated_fits(quantity, both, np.outer(change, change), spread[0] + spread[1], 1)
        for quantity in quantities
    )


def _covariance(fit: _Fit) -> Floats:
    """Covariance (n, n) of the devices, without the board's scale, which is the same in every fit."""
    observations, solution, model, sizes = fit
    return estimate_uncertainty(observations, solution, replace(model, scale_tolerance=0.0), sizes).covariance


def _devices(solution: Solution, model: Model) -> Floats:
    """The parameters (n,) of both devices and of the pose between them."""
    free = len(model.level.terms)
    return np.concatenate([solution.camera[:free], solution.projector[:free], solution.T_projector_camera])


def _quantities(fit: _Fit) -> tuple[_Quantity, ...]:
    _, best, model, _ = fit
    free = len(model.level.terms)
    n = 2 * free + 6
    every, translation = np.eye(n), best.T_projector_camera[3:]
    baseline = np.append(np.zeros(n - 3), translation / np.linalg.norm(translation))
    probes = _probes(fit)
    moved = moved_points(best, model.level, probes)
    points = len(probes)
    return (
        _Quantity("camera.fx", "px", every[:1]),
        _Quantity("projector.fx", "px", every[free : free + 1]),
        _Quantity("baseline", "mm", baseline[None]),
        _Quantity("place", "mm", moved, 1.0 / points),
        _Quantity("form", "mm", without_motion(moved, probes), 1.0 / points),
    )


def _probes(fit: _Fit, points_per_pose: int = 9) -> Floats:
    """Points (m, 3) in the camera's frame where the boards were, in mm; about as many for each pose."""
    observations, best, _, _ = fit
    places = []
    for observation, pose in zip(observations, best.poses, strict=True):
        chosen = observation.ids[:: max(1, len(observation.ids) // points_per_pose)]
        places.append(RigidTransform.from_vectors(pose[:3], pose[3:]).apply(best.board[chosen]))
    return np.concatenate(places)


def projected_uncertainty(
    calibration: Calibration, device: str, pixels: Floats, distance_mm: float
) -> Floats:
    """Compute how uncertain the pixel is at which a device sees a place, over its image."""
    # That a device might be turned as a whole does not count: a rotation and a shifted principal point cannot
    # be distinguished from one another. So the best common rotation is removed.
    # pixels (m, 2) px; returns (m,) px
    uncertainty, lens = calibration.uncertainty, getattr(calibration, device)
    if uncertainty is None:
        raise CalibrationError("the calibration does not say how uncertain it is; characterise again")
    places = distance_mm * np.column_stack([lens.normalise(pixels), np.ones(len(pixels))])
    slopes = project_with_derivatives(places, np.zeros(6), lens.intrinsics)[1]
    own = [k for k, name in enumerate(uncertainty.names) if name.startswith(f"{device}.")]
    terms = [6 + INTRINSICS.index(uncertainty.names[k].removeprefix(f"{device}.")) for k in own]
    turned, _ = np.linalg.qr(slopes[:, :3])
    remaining = slopes[:, terms] - turned @ (turned.T @ slopes[:, terms])
    variance = np.einsum(
        "ri,ij,rj->r", remaining, uncertainty.covariance[np.ix_(own, own)], remaining
    ).reshape(-1, 2)
    return np.asarray(np.sqrt(variance.mean(axis=1)))
