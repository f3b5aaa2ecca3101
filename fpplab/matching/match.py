"""Characterisation matching: step by step nearer to the bench, as long as the loss allows it.

The steps follow what bears on what: geometry by the points observed, light, then one by one what the paper
names as missing (ambient light, defocus of projector and camera, vignetting, noise), and at last everything
together and the geometry by the images in turn, until it stays. Each step is one epoch.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.config import Document
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.matching import geometry, light, noise
from fpplab.matching.evaluation import TwinEvaluation, evaluate
from fpplab.matching.light import Sample
from fpplab.matching.loss import Weights
from fpplab.matching.record import MatchingEpoch, MatchingRecord, ParametersFile
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import Parameters, Twin

SAMPLED_POSES = 6
TIE = 2e-4
"""Losses that differ by less are the same but for noise; the images' mean difference decides then."""
F_NUMBERS = (1.0, 2.0, 4.0)
APERTURES = (0.5, 1.0, 2.0)
"""Relative to the twin's own, with which a focus is first tried."""
EXPLAINS = {
    "projector defocus": "blur of the projector that grows with the distance from its focus",
    "depth of field": "blur of the camera that grows with the distance from its focus",
    "vignetting": "light that the camera's lens loses towards the picture's corners",
    "ambient light": "light that is not the projector's, and the camera's black level",
    "noise": "noise of the sensor and vibration",
}
"""What is matched beyond the paper, by step."""
FOCUSES = {"projector defocus", "depth of field"}
"""Steps before which the twin is sharp where it need not be."""


class Limits(Document):
    """When to stop: after so many epochs or seconds, or when `patience` rounds of the last steps gained less
    than `converged` of the loss.
    """

    epochs: int = 25
    seconds: float = 900.0
    patience: int = 1
    converged: float = 2e-4


@dataclass(frozen=True, eq=False)
class Context:
    """What every step is given: where the images are looked at, and what is free."""

    bench: Reference
    twin: Twin
    looked: list[Sample]
    white: str

    def lights(self, *more: str) -> tuple[str, ...]:
        response = () if self.bench.response is not None else ("b", "g")
        return (self.white, "ink", "ambient", "black_level", *response, *more)

    def fit(self, *names: str) -> Parameters:
        return light.fit_light(self.bench, self.twin, names, self.looked)


@dataclass(frozen=True)
class Step:
    """Something to try. characterises: whether the twin's own RMS must be found anew."""

    name: str
    propose: Callable[[Context], Parameters]
    characterises: bool = False


def _projector_defocus(at: Context) -> Parameters:
    names = ("projector_focus_mm", "projector_aperture_mm")
    if at.twin.parameters.projector_focus_mm is None:
        light.coarse_focus(at.bench, at.twin, at.looked, *names, APERTURES)
    if at.twin.parameters.projector_focus_mm is None:
        return at.fit("projector_blur")
    return at.fit("projector_blur", *names)


def _depth_of_field(at: Context) -> Parameters:
    names = ("camera_focus_mm", "f_number")
    if at.twin.parameters.camera_focus_mm is None:
        light.coarse_focus(at.bench, at.twin, at.looked, *names, F_NUMBERS)
    if at.twin.parameters.camera_focus_mm is None:
        return at.twin.parameters
    return at.fit("projector_blur", *names)


def _together(at: Context) -> Parameters:
    now = at.twin.parameters
    names = ["projector_blur", "vignetting"]
    if now.projector_focus_mm is not None:
        names += ["projector_focus_mm", "projector_aperture_mm"]
    if now.camera_focus_mm is not None:
        names += ["camera_focus_mm", "f_number"]
    return at.fit(*at.lights(*names))


def _by_images(at: Context) -> Parameters:
    return geometry.by_images(at.bench, at.twin, at.bench.characterisation.level)


FIRST = (
    Step("points", lambda at: geometry.by_reprojection(at.twin.parameters, at.bench.characterisation)),
    Step("light", lambda at: at.fit(at.white, "ink", "projector_blur")),
    Step("ambient light", lambda at: at.fit(*at.lights())),
    Step("projector defocus", _projector_defocus),
    Step("depth of field", _depth_of_field),
    Step("vignetting", lambda at: at.fit(at.white, "vignetting")),
    Step(
        "noise", lambda at: noise.match_noise(at.bench, at.twin, at.bench.spread_poses(SAMPLED_POSES)), True
    ),
)
AGAIN = (Step("together", _together), Step("images", _by_images))


@dataclass(frozen=True, eq=False)
class Matched:
    """Where a matching ended. explained: by step, share of the mean square difference that it took away; of
    noise the share of what is left at the end that the twin's own noise makes.

    unexplained: RMS over the board of what is left, in raw levels; ended: why it stopped.
    """

    parameters: Parameters
    epochs: tuple[MatchingEpoch, ...]
    final: TwinEvaluation
    explained: dict[str, float]
    unexplained: float
    ended: str

    @property
    def focused(self) -> bool:
        """Whether it lasted long enough for its edges to be compared with the bench's."""
        return {epoch.step for epoch in self.epochs} >= FOCUSES


@dataclass(eq=False)
class _State:
    at: Context
    weights: Weights
    record: MatchingRecord
    epochs: list[MatchingEpoch]
    started: float

    @property
    def best(self) -> MatchingEpoch:
        return _best(self.epochs)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started


EpochObserver = Callable[[MatchingEpoch], None]


def match_twin(
    bench: Reference,
    twin: Twin,
    start: Parameters,
    record: MatchingRecord,
    weights: Weights,
    limits: Limits,
    *,
    progress: Progress = no_progress,
    observe: EpochObserver = ignore,
) -> Matched:
    """Match `twin` to `bench` from `start`, or go on where the record ends.

    observe: is given every epoch as it ends. Leaves the twin matched. Raises `CalibrationError` when the twin
    cannot be characterised, or no step can be made.
    """
    epochs = record.read()
    begin = _best(epochs).parameters.parameters() if epochs else start
    twin.become(begin)
    white = "paper" if bench.response is not None else "white"
    looked = _looked(bench, begin)
    before = epochs[-1].seconds if epochs else 0.0
    state = _State(Context(bench, twin, looked, white), weights, record, epochs, time.monotonic() - before)
    if not epochs:
        first = evaluate(bench, twin, weights)
        _note(state, "start", first, _difference(state), True, observe)
    ended = _run(state, limits, progress, observe)
    twin.become(state.best.parameters.parameters())
    final = evaluate(bench, twin, weights)
    state.at = replace(state.at, looked=_looked(bench, twin.parameters))
    left = _difference(state)
    explained = shares(state.epochs) | {"noise": _noise(state) / left**2}
    return Matched(twin.parameters, tuple(state.epochs), final, explained, left, ended)


def _best(epochs: Sequence[MatchingEpoch]) -> MatchingEpoch:
    """The last that was accepted."""
    return next(epoch for epoch in reversed(epochs) if epoch.accepted)


def shares(epochs: Sequence[MatchingEpoch]) -> dict[str, float]:
    """Of what each step of `EXPLAINS` but noise found before it, the share of the mean square it took away.

    Shadows need relief: a flat board has none, so nothing of its images is theirs.
    """
    found, last = {"shadowing": 0.0}, epochs[0]
    for epoch in epochs[1:]:
        if epoch.step in EXPLAINS and epoch.step != "noise" and last.difference > 0:
            gained = 1.0 - (epoch.difference / last.difference) ** 2
            found[epoch.step] = gained if epoch.accepted else 0.0
        if epoch.accepted:
            last = epoch
    return found


def _looked(bench: Reference, parameters: Parameters) -> list[Sample]:
    images = sorted({*bench.one_of_each_set, *bench.finest})
    return light.samples(bench, parameters, bench.spread_poses(SAMPLED_POSES), images)


def _steps() -> Iterator[Step]:
    yield from FIRST
    while True:
        yield from AGAIN


def _run(state: _State, limits: Limits, progress: Progress, observe: EpochObserver) -> str:
    """Step until one of the limits; says which."""
    idle = 0
    for number, step in enumerate(_steps(), 1):
        if number >= len(state.epochs):  # not taken by an earlier run
            if number > limits.epochs:
                return f"after {limits.epochs} epochs"
            if state.seconds > limits.seconds:
                return f"after {state.seconds:.0f} s"
            progress(min(1.0, number / (len(FIRST) + 2 * len(AGAIN))))
            _take(state, step, observe)
        if number > len(FIRST) and (number - len(FIRST)) % len(AGAIN) == 0:
            before, after = (
                _best(state.epochs[:end]).loss["loss_board"] for end in (number + 1 - len(AGAIN), number + 1)
            )
            idle = idle + 1 if before - after < limits.converged else 0
            if idle >= limits.patience:
                return "converged"
    raise AssertionError("the steps have no end")


def _take(state: _State, step: Step, observe: EpochObserver) -> None:
    best, twin = state.best, state.at.twin
    twin.become(best.parameters.parameters())
    tried = step.propose(state.at)
    twin.become(tried)
    known = None if step.characterises else best.loss["epsilon_v_px"]
    found = evaluate(state.at.bench, twin, state.weights, known)
    state.at = replace(state.at, looked=_looked(state.at.bench, tried))
    difference = _difference(state)
    _note(state, step.name, found, difference, _accepted(best, found, difference), observe)


def _accepted(best: MatchingEpoch, found: TwinEvaluation, difference: float) -> bool:
    """By the loss over the board; where that is a tie, by the images' mean difference."""
    gain = best.loss["loss_board"] - found.loss.board
    if abs(gain) > TIE:
        return gain > 0
    return difference <= best.difference * (1.0 + 1e-3)


def _difference(state: _State) -> float:
    return float(np.sqrt(light.difference(state.at.bench, state.at.twin, state.at.looked)))


def _noise(state: _State) -> float:
    """Mean square of the twin's own noise where the images are looked at: noise is in no expected image."""
    bench, twin = state.at.bench, state.at.twin
    squares = []
    for sample in state.at.looked:
        patterns = bench.shown(sample.images)
        expected = twin.expected_at(sample.pose, patterns, bench.settings, sample.pixels)
        for frame, level in zip(twin.frames(sample.pose, patterns, bench.settings), expected, strict=True):
            off = frame[sample.pixels].astype(np.float64) - level
            squares.append(float(np.mean(off**2)))
    return float(np.mean(squares))


def _note(
    state: _State, name: str, found: TwinEvaluation, difference: float, accepted: bool, observe: EpochObserver
) -> None:
    if not np.isfinite(found.loss.board):
        raise CalibrationError(f"the step '{name}' led to no image that can be compared")
    epoch = MatchingEpoch(
        epoch=len(state.epochs),
        step=name,
        accepted=accepted,
        loss=found.loss.summary(),
        difference=difference,
        seconds=state.seconds,
        parameters=ParametersFile.of(state.at.twin.parameters),
    )
    state.record.add(epoch)
    state.epochs.append(epoch)
    observe(epoch)
