"""Predicts the scores of candidates on a simulation, from bands of the camera's rows, many times quicker.

Bands and the noise of a seed are the same for all candidates, so that both cancel. Points are triangulated
with the simulation's own calibration. Where a twin states how uncertain it is, every seed draws another one.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numba
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.errors import ConfigError, DataError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import FrameSampler, Predictable
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.measuring import possible_coordinates
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.scoring import ArtefactFigures, TrueShape
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.exposures import merged_recording


@dataclass(frozen=True)
class ScreeningLimits:
    """Sizes of what a screening simulates."""

    bands: int = 2  # parts of the image for each artefact (chosen)
    rows: int = 14  # rows of such a part (chosen)
    border: int = 3  # rows and columns at each edge of a part that serve as neighbours alone (chosen)
    density_per_mm2: float = 60.0  # samples of the true surface (chosen: some thousands in each part)
    max_sets: int = 8  # fringe sets by which noise is numbered: the greatest number in study files
    max_draws: int = 1 << 20  # sets by which noise is numbered before those of a further exposure (chosen)
    kept_sets: int = 32  # fringe sets whose patterns are kept in memory (chosen)


LIMITS = ScreeningLimits()


@dataclass(frozen=True, eq=False)
class _ImagePart:
    """A part of the camera's image that sees an artefact."""

    rows: np.ndarray[tuple[int], np.dtype[np.intp]]
    columns: np.ndarray[tuple[int], np.dtype[np.intp]]
    calibration: Calibration
    shape: TrueShape


def can_screen(rig: Rig, problem: SearchProblem) -> bool:
    moves = problem.space.stage_mm is not None or problem.space.convergence_deg is not None
    return problem.screening and isinstance(rig.simulation, Predictable) and not moves


class SampledEvaluator:
    """Predicts scores on a rig of a simulation, which is opened when first needed."""

    def __init__(self, rig: str, problem: SearchProblem) -> None:
        self._file, self._problem, self._stack = rig, problem, ExitStack()
        self._samplers: dict[int, FrameSampler] = {}
        self._parts: dict[str, list[_ImagePart]] = {}
        self._patterns: OrderedDict[PatternSet, tuple[Pattern, ...]] = OrderedDict()

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        dead = RigLimits.of(self._rig).dead_time_s + self._problem.start.settle_s
        seconds = candidate.seconds(dead)
        scores = []
        for name in self._problem.artefacts:
            with _one_thread():
                figures = asdict(self._figures(name, candidate, seed))
            del figures["surface_spread_um"]
            scores.append(
                Score(artefact=name, seed=seed, images=candidate.images, seconds=seconds, **figures)
            )
        return tuple(scores)

    def close(self) -> None:
        self._stack.close()

    @cached_property
    def _rig(self) -> Rig:
        rig = self._stack.enter_context(Rig.load(self._file))
        if not isinstance(rig.simulation, Predictable):
            raise ConfigError(f"{rig.source}: is no simulation that can predict; name a twin's rig file")
        return rig

    def _sampler(self, seed: int) -> FrameSampler:
        if seed not in self._samplers:
            assert isinstance(self._rig.simulation, Predictable)
            self._samplers[seed] = self._rig.simulation.image_part_sampler(seed)
        return self._samplers[seed]

    def _figures(self, name: str, candidate: Candidate, seed: int) -> ArtefactFigures:
        weighted: list[tuple[int, ArtefactFigures]] = []
        parts = self._parts_of(name)
        for part in parts:
            plan, calibration = candidate.plan(self._problem.start), part.calibration
            bounds = possible_coordinates(
                plan, calibration, self._rig
            )  # raises where no part can be unwrapped
            recording = self._recorded(name, candidate, seed, part)
            with suppress(DataError):  # nothing is measured there, which makes the whole less complete
                figures = part.shape.score(decode(recording, bounds=bounds), plan, calibration, align=False)
                weighted.append((part.shape.surface_points, figures))
        if not weighted:
            raise DataError(f"nothing of the {name} could be measured")
        return _combine_figures_of_parts(weighted, sum(part.shape.surface_points for part in parts))

    def _recorded(self, name: str, candidate: Candidate, seed: int, part: _ImagePart) -> Recording:
        plan, sampler = candidate.plan(self._problem.start), self._sampler(seed)
        several = [self._rig.camera_settings(each, plan.bits) for each in candidate.exposures]
        first = LIMITS.max_sets * (seed + 1)
        frames = [
            frame
            for taken, settings in enumerate(several)
            for number, shown in enumerate(candidate.fringes, first + LIMITS.max_draws * taken)
            for frame in sampler.frames(
                name, self._patterns_of(shown), settings, part.rows, number, part.columns
            )
        ]
        size = part.calibration.projector.size
        name, bayer = f"a part of the {name}", self._rig.camera.caps.bayer
        raw = Recording(frames, plan, size, several[0].bits, name, bayer=bayer)
        return merged_recording(raw, candidate.exposures)

    def _patterns_of(self, shown: PatternSet) -> tuple[Pattern, ...]:
        """Make the patterns of a set once: the simulation keeps what it computes by the patterns it got."""
        if shown not in self._patterns:
            caps = self._rig.projector.caps
            plan = self._problem.start.model_copy(update={"fringes": (shown,)})
            self._patterns[shown] = tuple(make_patterns(plan, caps.size, caps.lattice))
        self._patterns.move_to_end(shown)
        while len(self._patterns) > LIMITS.kept_sets:
            self._patterns.popitem(last=False)
        return self._patterns[shown]

    def _parts_of(self, name: str) -> list[_ImagePart]:
        if name not in self._parts:
            calibration = self._sampler(0).calibration
            shape = TrueShape(
                self._sampler(0).mesh(name), calibration, samples=None, density=LIMITS.density_per_mm2
            )
            self._parts[name] = _image_parts(shape, calibration)
        return self._parts[name]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let compiled loops run in this thread alone: for so few pixels, waking others takes longer."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _image_parts(shape: TrueShape, calibration: Calibration) -> list[_ImagePart]:
    height, width = shape.visible.shape
    seen_rows, seen_columns = (np.flatnonzero(shape.visible.any(axis=axis)) for axis in (1, 0))
    left, right = max(0, seen_columns[0] - LIMITS.border), min(width, seen_columns[-1] + 1 + LIMITS.border)
    share = (np.arange(LIMITS.bands) + 0.5) / LIMITS.bands
    middles = seen_rows[0] + share * (seen_rows[-1] - seen_rows[0])
    tops = np.clip(np.rint(middles - LIMITS.rows / 2), 0, height - LIMITS.rows).astype(int)
    parts = []
    for top in tops.tolist():
        corner, size = (int(left), top), (int(right - left), LIMITS.rows)
        cropped = replace(calibration, camera=calibration.camera.cropped(corner, size))
        with suppress(DataError):  # in the shadow
            part = shape.part(cropped.camera, corner, LIMITS.border)
            parts.append(_ImagePart(np.arange(top, top + LIMITS.rows), np.arange(left, right), cropped, part))
    if not parts:
        raise DataError(f"no band of {LIMITS.rows} rows of the image sees lit surface of the shape")
    return parts


def _combine_figures_of_parts(
    weighted: Sequence[tuple[int, ArtefactFigures]], of_all: int
) -> ArtefactFigures:
    """Figures of all parts: means weighted by how much surface each has, of `of_all` points."""
    weights = np.array([points for points, _ in weighted], np.float64)

    def mean(name: str, total: float = float(weights.sum()), power: int = 1) -> float:
        values = np.array([getattr(figures, name) for _, figures in weighted])
        return float((weights @ values**power / total) ** (1 / power))

    return ArtefactFigures(
        points=sum(figures.points for _, figures in weighted),
        surface_smcd_um=mean("surface_smcd_um"),
        smcd_um=mean("smcd_um"),
        smcd_floor_um=mean("smcd_floor_um"),
        surface_rms_um=mean("surface_rms_um", power=2),
        completeness=mean("completeness", of_all),
        wrong_orders=mean("wrong_orders"),
        outliers=mean("outliers"),
        surface_spread_um=mean("surface_spread_um", power=2) / np.sqrt(len(weighted)),
    )
