"""Rigs that have changed since they were characterised: what is called good, found, and corrected by marks.

A rig is characterised, and its reference marks located. Then its true geometry is changed, in one kind and
size at a time, and a part is scanned, along one axis or two, with marks in view or without. Coordinates are
drawn from exact truths: no image is rendered. A scan is *beyond* where the errors of its points, without
noise, exceed the interval of 95 % that the calibration states for them, in place or in form, and the errors
before the change. Without marks it is judged after the hours for which the rig's owner answers: it must be
unverified then, and state what it would not show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import Result, above, below
from benchmarks.guided_characterisation import PROJECTOR_PX, Rigged, rigged, unguided
from fpplab.calibration.board import LocatedMarks
from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.characterisation import Observation, characterise
from fpplab.characterisation.marks import compare_marks
from fpplab.characterisation.parameters import DistortionModel
from fpplab.characterisation.working_volume import without_motion
from fpplab.clouds import Cloud
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices import CameraSettings, Frame
from fpplab.diagnosis.causes.stale_calibration import StaleCalibrationLimits
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.pipeline.geometry import geometry_check
from fpplab.pipeline.marks import marks_verdict, widened_by_marks
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_slopes, coordinate_noise
from fpplab.reconstruction.uncertainty import with_uncertainty
from fpplab.sessions.session import Session
from fpplab.targets import Target
from fpplab.targets.kinds.marks import ReferenceMarks

SEEDS = range(7110, 7115)
"""Of the rigs that judge; development used those below 100."""
SIZES = np.geomspace(0.03, 10.0, 10)
"""Sizes of a change, in units of what happens unnoticed."""
COVERAGE = 1.96
"""Half of the interval of 95 %, in standard deviations."""
POSES, NEW_POSES = 12, 12
HEALTHY = 20
"""Scans of each rig without a change."""
PIXEL_STEP = 6
"""Every so manieth pixel of the camera sees the part."""
HIDDEN_MARKS = 0.5
"""Share of the marks that the part hides."""
STATED_H, AGE_H = 8.0, 9.0
"""For how long the rig's owner answers for its geometry, and how long ago a board showed it."""

Change = Callable[[Calibration, float], Calibration]


def _turned(device: str, axis: int) -> Change:
    def change(rig: Calibration, size: float) -> Calibration:
        turn = RigidTransform.from_vectors(np.radians(0.1 * size) * np.eye(3)[axis], np.zeros(3))
        pose = rig.T_projector_camera
        return replace(rig, T_projector_camera=turn @ pose if device == "projector" else pose @ turn)

    return change


def _longer_baseline(rig: Calibration, size: float) -> Calibration:
    shift = RigidTransform.from_vectors(np.zeros(3), np.array([size, 0.0, 0.0]))
    return replace(rig, T_projector_camera=rig.T_projector_camera @ shift)


def _lens(device: str, zoom: float, px: tuple[float, float], k1: float = 0.0) -> Change:
    def change(rig: Calibration, size: float) -> Calibration:
        lens: Pinhole = getattr(rig, device)
        matrix, distortion = lens.matrix.copy(), lens.distortion.copy()
        matrix[[0, 1], [0, 1]] *= 1.0 + zoom * size
        matrix[:2, 2] += size * np.array(px)
        distortion[0] += k1 * size
        changed = replace(lens, matrix=matrix, distortion=distortion)
        return replace(rig, camera=changed) if device == "camera" else replace(rig, projector=changed)

    return change


KINDS: dict[str, Change] = {
    **{f"projector turned about {name}": _turned("projector", axis) for axis, name in enumerate("xyz")},
    **{f"camera turned about {name}": _turned("camera", axis) for axis, name in enumerate("xyz")},
    "baseline": _longer_baseline,
    "region of the camera": _lens("camera", 0.0, (2.0, -1.0)),
    "picture of the projector": _lens("projector", 0.0, (2.0, -1.0)),
    "zoom of the camera": _lens("camera", 0.003, (0.0, 0.0)),
    "zoom of the projector": _lens("projector", 0.003, (0.0, 0.0)),
    "focus of the camera": _lens("camera", -0.002, (0.5, 0.5), 0.002),
}


@dataclass(frozen=True)
class JudgedChange:
    """One scan with marks in view."""

    kind: str
    size: float
    axes: int
    place: float  # error over what is stated, RMS
    form: float  # the same after the best rigid motion
    beside_calibration: float  # the greater of both errors, over what the calibration alone states
    good: bool  # whether the marks verify it, and nothing else is told
    told: bool  # whether marks or epipolar lines show a change
    told_without: bool  # whether epipolar lines alone do
    unverified_without: bool  # whether a scan without marks is unverified at best
    hidden_without: bool  # whether it states what it would not show
    corrected: float  # error of the corrected calibration in place, in mm
    anew: float = np.nan  # the same of a new characterisation
    before: tuple[float, float] = (0.0, 0.0)  # `place` and `form` before the change

    @property
    def beyond(self) -> bool:
        """Whether errors exceed the interval that is stated, because of the change."""
        return any(
            now > max(COVERAGE, 1.05 * before)
            for now, before in zip((self.place, self.form), self.before, strict=True)
        )


@dataclass(frozen=True, eq=False)
class MarkedRig:
    """A characterised rig with reference marks and a part."""

    rig: Rigged
    calibration: Calibration
    layout: ReferenceMarks
    marks: Floats  # (P, 3) true points of all marks in mm
    located: LocatedMarks
    session: Session  # that says when scans are taken
    depth: Floats  # (height, width) of the part in mm, NaN beside it

    @classmethod
    def drawn(cls, seed: int, folder: Path) -> MarkedRig:
        """Draw and characterise a rig; scans are taken after what its owner answers for."""
        rig, target = rigged(seed), Target.load("target_marks")
        shown = CalibrationOrigin.now(poses_taken=datetime.now(UTC) - timedelta(hours=AGE_H))
        calibration = replace(_characterised(rig, seed, POSES), origin=shown)
        marks = _folded(target.points(), rig.random)
        seen = _observed(rig, rig.truth, marks, "located", 2)
        located = LocatedMarks(config.plain(target), seen.ids, seen.camera_px, seen.projector_px)
        width, height = rig.truth.camera.size
        v, u = np.indices((height, width)) / width
        depth = 455.0 + 30.0 * (u - 0.5) - 15.0 * v + 8.0 * np.sin(9 * u) * np.cos(7 * v)
        hidden = (np.abs(u - 0.5) > 0.3) | (np.abs(v - 0.33) > 0.2)
        hidden |= ((np.arange(width) % PIXEL_STEP)[None] > 0) | (
            (np.arange(height) % PIXEL_STEP)[:, None] > 0
        )
        assert isinstance(target.layout, ReferenceMarks)
        depth = np.where(hidden, np.nan, depth)
        return cls(rig, calibration, target.layout, marks, located, _session(folder), depth)

    def judged(self, kind: str, size: float, axes: int, with_correction: bool) -> JudgedChange:
        """Change the rig, scan, and judge."""
        now = KINDS[kind](self.rig.truth, size) if size else self.rig.truth
        true, exact = self._seen(now, axes, 0.0)
        decoded = self._seen(now, axes, PROJECTOR_PX)[1]
        noise, stated = coordinate_noise(decoded), self.calibration
        cloud = triangulate(decoded, stated, normals=False)
        place, form = _errors(triangulate(exact, stated, normals=False), true)
        off = systematic_epipolar_px(cloud)
        told_without = off is not None and off > StaleCalibrationLimits().max_epipolar_px
        circles = self.layout.circles()
        shown = circles[self.rig.random.random(len(circles)) > HIDDEN_MARKS].ravel()
        seen = _observed(self.rig, now, self.marks, "scan", axes, shown)
        compared = compare_marks(stated, self.located, seen)
        verdict = marks_verdict(compared, cloud, noise, stated)
        told = told_without or verdict.change is not None
        without = geometry_check(self.session, decoded, cloud, stated, None)
        corrected = np.nan
        if told and with_correction:
            corrected = _errors(triangulate(exact, compared.corrected, normals=False), true)[0]
        by_calibration, at_scan = (
            with_uncertainty(cloud, known, noise) for known in (stated, widened_by_marks(stated, compared))
        )
        beside = max(_errors_over_stated(by_calibration, place, form))
        return JudgedChange(
            kind, size, axes, *_errors_over_stated(at_scan, place, form), beside,
            verdict.verified and not told, told, told_without, without.doubt is not None,
            bool(without.hidden), corrected,
        )  # fmt: skip

    def new_error(self, kind: str, size: float, axes: int, seed: int) -> float:
        """Error in place of a new characterisation of the changed rig."""
        now = KINDS[kind](self.rig.truth, size)
        true, exact = self._seen(now, axes, 0.0)
        anew = _characterised(replace(self.rig, truth=now), seed, NEW_POSES)
        return _errors(triangulate(exact, anew, normals=False), true)[0]

    def _seen(self, now: Calibration, axes: int, noise_px: float) -> tuple[Floats, Decoded]:
        """True points (height, width, 3) of the part, and what decoding gives of them."""
        true = np.stack([*(s * self.depth for s in camera_slopes(now.camera)), self.depth], axis=-1)
        seen = now.projector.project(true, now.T_projector_camera)
        seen += self.rig.random.normal(0, noise_px, seen.shape) if noise_px else 0.0
        u, v = np.moveaxis(seen.astype(np.float32), -1, 0)
        sigma = np.where(np.isfinite(u), np.float32(PROJECTOR_PX), np.float32(np.nan))
        flat = np.where(np.isfinite(u), np.float32(100), np.float32(0))
        return true, Decoded(u, v if axes == 2 else np.full_like(v, np.nan), flat, sigma)


def _session(folder: Path) -> Session:
    """Take frames at this time, on a rig that states its limit."""
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=3),))
    session = Session.create(folder, plan, {"geometry": {"max_age_h": STATED_H}})
    for index, (_, _, pattern) in enumerate(plan.steps()):
        settings, time_s = CameraSettings(0.02, 0.0, 8), datetime.now(UTC).timestamp()
        session.write(Frame(np.zeros((12, 16), np.uint8), index, settings, time_s, pattern_id=pattern))
    return session


def _folded(points: Floats, random: np.random.Generator) -> Floats:
    """Place a sheet of marks that is folded along a line: upright behind the part, and lying before that."""
    fold_deg, crease = float(random.uniform(40, 70)), 13.0
    lying = RigidTransform.from_vectors(np.radians([fold_deg, 0, 0]), np.array([0.0, crease, 0.0]))
    below = points[:, 1] > crease
    folded = np.where(below[:, None], lying.apply(points - [0.0, crease, 0.0]), points)
    place = np.array([*random.uniform(-4, 4, 2), random.uniform(500, 520)])
    return RigidTransform.from_vectors(np.radians(random.uniform(-5, 5, 3)), place).apply(folded)


def _observed(
    rig: Rigged, truth: Calibration, points: Floats, name: str, axes: int, ids: NDArray[np.intp] | None = None
) -> Observation:
    """See points as the board's are seen, with the same noise."""
    seen = replace(rig, truth=truth, board=points).observed(name, RigidTransform.identity())
    rows = np.arange(len(seen.ids)) if ids is None else np.flatnonzero(np.isin(seen.ids, ids))
    projector_px = seen.projector_px[rows].copy()
    if axes == 1:
        projector_px[:, 1] = np.nan
    return Observation(name, seen.ids[rows], seen.camera_px[rows], projector_px)


def _characterised(rig: Rigged, seed: int, poses: int) -> Calibration:
    truth, target = rig.truth, Target.load("target_paper")
    sizes = (truth.camera.size, truth.projector.size)
    observations = unguided(rig, seed, poses)
    return characterise(
        observations, target, *sizes, truth.projector.lattice, level=DistortionModel.K3
    ).calibration


def _errors(cloud: Cloud, true: Floats) -> tuple[float, float]:
    """RMS distance in mm of points from the true ones, as they are and after the best rigid motion."""
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    at = true[v, u]
    off = cloud.points.astype(np.float64) - at
    form = without_motion(off.reshape(-1, 1), at).reshape(-1, 3)
    return float(np.sqrt(np.square(off).sum(axis=1).mean())), float(
        np.sqrt(np.square(form).sum(axis=1).mean())
    )


def _errors_over_stated(cloud: Cloud, place: float, form: float) -> tuple[float, float]:
    assert cloud.sigma_calibration_mm is not None
    assert cloud.sigma_form_mm is not None
    return place / _rms(cloud.sigma_calibration_mm), form / _rms(cloud.sigma_form_mm)


def _share(told: list[bool]) -> float:
    return float(np.mean(told))


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def judged_changes(seed: int) -> Iterator[JudgedChange]:
    """Judge each kind and size of change on one rig, and scans without a change."""
    with TemporaryDirectory() as folder:
        yield from _judged_changes(MarkedRig.drawn(seed, Path(folder) / "scan"), seed)


def _judged_changes(bench: MarkedRig, seed: int) -> Iterator[JudgedChange]:
    for axes in (1, 2):
        unchanged = [bench.judged("baseline", 0.0, axes, False) for _ in range(HEALTHY)]
        yield from unchanged
        before = unchanged[0].place, unchanged[0].form
        for kind in KINDS:
            for n, size in enumerate(SIZES * bench.rig.random.choice([-1, 1], len(SIZES))):
                judged = bench.judged(kind, float(size), axes, n == len(SIZES) - 3)
                if np.isfinite(judged.corrected):
                    new = bench.new_error(kind, float(size), axes, seed + n)
                    judged = replace(judged, anew=new)
                yield replace(judged, before=before)


def run() -> list[Result]:
    """Judge all kinds and sizes on several rigs."""
    return results_of([judged for seed in SEEDS for judged in judged_changes(seed)])


def results_of(judged: list[JudgedChange]) -> list[Result]:
    """Count what was called good and beyond, found and corrected."""
    healthy = [one.good for one in judged if not one.size]
    results = [above("scans without a change that are good", float(np.mean(healthy)), "", 1.0)]
    for axes in (1, 2):
        some, name = [one for one in judged if one.size and one.axes == axes], f"{axes} axes"
        clear = [one for one in some if one.beside_calibration > 2.0 * max(1.0, *one.before)]
        believed = [max(one.place, one.form) for one in some if one.beyond and one.good]
        corrected = np.array([(one.corrected, one.anew) for one in some if np.isfinite(one.corrected)])
        results += [
            below(f"{name}: good beyond its interval, of {len(some)}", len(believed), "scans", 0.5),
            below(
                f"{name}: greatest of these errors, over what is stated",
                max(believed, default=0.0),
                "",
                COVERAGE,
            ),
            above(f"{name}: errors over twice those stated, told", _share([o.told for o in clear]), "", 0.95),
            above(
                f"{name}: past the rig's limit without marks, unverified",
                _share([o.unverified_without for o in some]),
                "",
                1.0,
            ),
            above(
                f"{name}: errors over twice those stated, without marks told or listed as what may be",
                _share([o.told_without or o.hidden_without for o in clear]),
                "",
                1.0,
            ),
            below(
                f"{name}: corrected over characterised anew",
                _rms(corrected[:, 0]) / _rms(corrected[:, 1]),
                "",
                1.2,
            ),
        ]
    return results
