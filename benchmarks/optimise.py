"""Searches on a matched twin and what they are worth on its bench, a hidden one, beside their targets.

Phase counts, stripe counts, the baseline of a bench as wide as the paper's, and the front of all together:
each is searched with one worker for every core, on the matched twin at rest. What is found is judged on the
twin as it is and on the hidden bench, which no search has seen; the baseline on its own bench, with seeds
that the search has not seen and by moving the stage. Rigs are characterised once, for all searches.

Speed is that of the paper's gradient descent through all of its epochs, with nothing on disk from an earlier
run but the characterisation, which is not counted. What rendering its images would take is extrapolated:
seconds of an image of each artefact that is rendered by itself, the mean of a sample, times the images of all
candidates; another seed is other noise on the same render, so it counts once. For two workers against one a
worker has one core, whether alone or not.
"""

import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean

import numpy as np

from benchmarks import Result, above, below
from benchmarks.optimise_workers import (
    WARM,
    KilledOnce,
    OnOneCore,
    candidates_like,
    timed_measurements,
)
from benchmarks.virtual import virtual_bench
from fpplab.cli import console
from fpplab.core.errors import DataError
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.candidate import Candidate, MeasuredCandidate
from fpplab.optimisation.confirm import Confirmation, ConfirmedPlan, RepeatedFigures, confirm_result
from fpplab.optimisation.measuring import RigEvaluatorFactory
from fpplab.optimisation.methods.gradient import Gradient
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.run import run_search
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.study import Study
from fpplab.patterns.fringes import make_patterns

MOST_IMAGES, FEWEST_IMAGES, IMAGES_OF_FRONT = 21, 12, (12, 24)
LEAST_PLANS, MOST_DEVIATION = 12, 2.0
LEAST_STRIPES_PERCENT, LEAST_STRIPES_HIDDEN_PERCENT, MOST_WRONG_PERCENT = 67.0, 70.0, 0.1
LEAST_BASELINE_PERCENT, INSIDE = 37.0, 0.01
"""INSIDE: of the searched range, by which a minimum lies within it."""
MOST_SECONDS, LEAST_FASTER, LEAST_BY_TWO = 600.0, 100.0, 1.7
COVERAGE = 2.0
"""Standard uncertainties by which a plan may seem worse than the start and be no worse."""


@dataclass(frozen=True)
class OptimiseBenchmarkSetup:
    """What is searched, and how much is timed."""

    search: str = "rig_matched_still.yaml"  # rig file of the twin on which searches measure
    twin: str = "rig_matched.yaml"  # rig files of the matched twin and of the hidden bench
    hidden: str = "rig_hidden.yaml"  # rig files of the matched twin and of the hidden bench
    wide: str = "rig_paper.yaml"  # rig file of the search of the baseline
    phases: str = "study_phases.yaml"  # study files
    stripes: str = "study_stripes.yaml"  # study files
    gradient: str = "study_stripes_gradient.yaml"  # study files
    baseline: str = "study_baseline_paper.yaml"  # study files
    pareto: str = "study_pareto.yaml"  # study files
    epochs: int = 64  # of the gradient descent
    rendered: int = 3  # images of each artefact that are rendered for comparison
    measured: int = 40  # candidates that are measured by one worker and by two
    workers: int = os.cpu_count() or 1  # processes that search


FULL = OptimiseBenchmarkSetup()


def run() -> list[Result]:
    """Measure searches; the baselines are the targets. It takes an hour or two on two cores."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return optimise_figures(Path(folder))


def optimise_figures(folder: Path, trial: OptimiseBenchmarkSetup = FULL) -> list[Result]:
    """Search, and confirm what is found on the hidden bench.

    Searches go on where their journals end; what is timed is done anew.
    """
    return [
        *_phases(folder, trial),
        *_stripes(folder, trial),
        *_baseline(folder, trial),
        *_pareto(folder, trial),
        *_speed(folder, trial),
        *_scale(folder, trial),
    ]


def _characterised(rig: str, name: str, folder: Path) -> Study:
    """The study of a file with calibrations of the rig, which are kept for the next."""
    with Rig.load(rig) as opened, console.progress(f"Characterising {rig} for {name}") as report:
        return with_calibrations(opened, Study.load(name), _of_rig(rig, folder), report)


def _of_rig(rig: str, folder: Path) -> Path:
    return folder / Path(rig).stem


def searched(what: SearchScope, rig: str, name: str, folder: Path, workers: int) -> SearchResult:
    """Search as `fpplab optimise` does; plans and journal stay in the folder."""
    study = _characterised(rig, name, folder)
    out = folder / (str(what) if what is SearchScope.PARETO else f"{what}.yaml")
    with console.progress(f"Searching {what} on {rig}"):
        found = run_search(what, rig, study, out, name, workers=workers)
    console.log_status(f"{what}: {len(found.trials)} candidates, {found.ended}")
    return found


def on_both(
    trial: OptimiseBenchmarkSetup, found: SearchResult, folder: Path
) -> list[tuple[ConfirmedPlan, ConfirmedPlan]]:
    """Confirm plans on the twin and on the hidden bench, side by side by several workers."""
    rigs = (trial.twin, trial.hidden)
    if trial.workers == 1:
        return list(zip(*(_confirmed(rig, found, folder) for rig in rigs), strict=True))
    with ProcessPoolExecutor(len(rigs), get_context("spawn")) as pool:
        both = [pool.submit(_confirmed, rig, found, folder) for rig in rigs]
        return list(zip(*(one.result() for one in both), strict=True))


def _confirmed(rig: str, found: SearchResult, folder: Path) -> tuple[ConfirmedPlan, ...]:
    with console.progress(f"Confirming on {rig}") as report:
        return confirm_result(rig, found, _of_rig(rig, folder), report)


def _phases(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    found = searched(SearchScope.PHASES, trial.search, trial.phases, folder, trial.workers)
    ((twin, hidden),) = on_both(trial, found, folder)
    return [
        below("optimise_phases_images", found.optimum.candidate.images, "images", MOST_IMAGES),
        no_worse("optimise_phases_smcd", twin.confirmation),
        no_worse("optimise_phases_smcd_hidden", hidden.confirmation),
    ]


def no_worse(name: str, found: Confirmation) -> Result:
    """Give the distance as a multiple of the start's, less its uncertainty, beside 1."""
    console.log_status(f"{name}: {1 - found.gain:.4f} ± {found.uncertainty:.4f} of the start's")
    least = 1.0 - found.gain - COVERAGE * found.uncertainty
    return below(name, least, f"of the start's, less {COVERAGE:g} u", 1.0)


def _stripes(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    found = searched(SearchScope.STRIPES, trial.search, trial.stripes, folder, trial.workers)
    ((twin, hidden),) = on_both(trial, found, folder)
    here, there = twin.confirmation, hidden.confirmation
    return [
        above("optimise_stripes_down", 100 * here.gain, "%", LEAST_STRIPES_PERCENT),
        above("optimise_stripes_down_hidden", 100 * there.gain, "%", LEAST_STRIPES_HIDDEN_PERCENT),
        below("optimise_stripes_wrong_orders", wrong_percent(here.after), "%", MOST_WRONG_PERCENT),
        below("optimise_stripes_wrong_orders_hidden", wrong_percent(there.after), "%", MOST_WRONG_PERCENT),
    ]


def wrong_percent(found: RepeatedFigures) -> float:
    """Give how many of all points are a fringe or more off."""
    measured = [one for repeats in found.values() for one in repeats]
    points = sum(one.points for one in measured)
    return 100 * sum(one.wrong_orders * one.points for one in measured) / points


def _baseline(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    found = searched(SearchScope.BASELINE, trial.wide, trial.baseline, folder, trial.workers)
    (moved,) = _confirmed(trial.wide, found, folder)
    least, most = (found.space.parameters[0].lower, found.space.parameters[0].upper)
    at = found.optimum.point[0]
    console.log_status(f"the baseline's minimum is at {at:g} mm of {least:g} to {most:g}")
    return [
        above("optimise_baseline_down", 100 * gain_of(found), "%", LEAST_BASELINE_PERCENT),
        above("optimise_baseline_down_moved", 100 * moved.confirmation.gain, "%", LEAST_BASELINE_PERCENT),
        above("optimise_baseline_inside", min(at - least, most - at), "mm", INSIDE * (most - least)),
    ]


def gain_of(found: SearchResult) -> float:
    """Give the gain of the optimum, with seeds that chose nothing."""
    if found.gain is None:
        raise DataError(f"{found.study.name}: start or optimum could not be measured with other seeds")
    return found.gain.down_percent / 100.0


def _pareto(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    found = searched(SearchScope.PARETO, trial.search, trial.pareto, folder, trial.workers)
    counts = [one.candidate.images for one in found.front]
    within = [n for n in counts if IMAGES_OF_FRONT[0] <= n <= IMAGES_OF_FRONT[1]]
    apart = [deviation(twin, hidden) for twin, hidden in on_both(trial, found, folder)]
    return [
        above("optimise_pareto_plans", len(within), "plans", LEAST_PLANS),
        below("optimise_pareto_fewest", min(counts), "images", FEWEST_IMAGES),
        below("optimise_pareto_vs_single", beside_singles(found), "of the single optimum's", 1.0),
        below("optimise_pareto_hidden", max(apart), "u", MOST_DEVIATION),
    ]


def beside_singles(found: SearchResult) -> float:
    """Compare a front with single-parameter searches.

    Of those with as many images, among all that were measured and keep the limits: the search of a front
    begins with searches of each kind of parameter by itself.
    """
    wanted = [trial for trial in found.trials if found.ranking.is_acceptable(trial)]
    single = [trial for trial in wanted if len(groups_changed(found, trial)) <= 1]
    return max(
        one.figures.surface_smcd_um / other.figures.surface_smcd_um
        for one in found.front
        for other in single
        if one.candidate.images == other.candidate.images
    )


def groups_changed(found: SearchResult, trial: MeasuredCandidate) -> set[str]:
    """Find the groups of parameters in which a candidate differs from the start."""
    values = zip(found.space.parameters, trial.point, found.start.point, strict=True)
    return {parameter.group for parameter, value, begin in values if value != begin}


def deviation(twin: ConfirmedPlan, hidden: ConfirmedPlan) -> float:
    """Compare the gains on twin and hidden bench."""
    one, other = twin.confirmation, hidden.confirmation
    for name, found in (("twin", one), ("hidden", other)):
        console.log_status(f"{twin.images} images, {name}: gain {found.gain:.4f} ± {found.uncertainty:.4f}")
    return abs(one.gain - other.gain) / float(np.hypot(one.uncertainty, other.uncertainty))


def _speed(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    study = _characterised(trial.search, trial.gradient, folder)
    assert isinstance(study.method, Gradient)
    # Never down by so much, it ends after just so many epochs.
    whole = study.method.model_copy(update={"gain": math.inf, "patience": trial.epochs})
    out = folder / "speed"
    shutil.rmtree(out, ignore_errors=True)
    begin = time.perf_counter()
    with own_cache(out), console.progress(f"Gradient descent through {trial.epochs} epochs"):
        descent = study.model_copy(update={"method": whole})
        found = run_search(
            SearchScope.STRIPES,
            trial.search,
            descent,
            out / "plan.yaml",
            trial.gradient,
            workers=trial.workers,
        )
    seconds = time.perf_counter() - begin
    images = len(study.artefacts) * sum(one.candidate.images for one in found.trials if one.measured)
    each = _seconds_rendered(trial.search, study, trial.rendered)
    console.log_status(
        f"{seconds:.0f} s; extrapolated from {each:.2f} s a render: {images} images in {images * each:.0f} s"
    )
    return [
        above("optimise_gradient_epochs", len(found.epochs) - 1, "epochs", trial.epochs),
        below("optimise_gradient_seconds", seconds, "s", MOST_SECONDS),
        above("optimise_vs_rendering_extrapolated", images * each / seconds, "times", LEAST_FASTER),
    ]


@contextmanager
def own_cache(folder: Path) -> Iterator[None]:
    """Let processes that begin meanwhile find nothing on disk that an earlier one left."""
    name = "XDG_CACHE_HOME"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before


def _seconds_rendered(rig: str, study: Study, count: int) -> float:
    """Of one image, the mean over so many of each artefact; each is a render of its own."""
    with Rig.load(rig) as opened, console.progress(f"Rendering {count} images of each artefact"):
        world = virtual_bench(opened).world
        render = world.render.model_copy(update={"path": "reference", "cache": False})
        virtual_bench(opened).replace_world(world.model_copy(update={"render": render}))
        caps, plan = opened.projector.caps, study.start
        opened.projector.load(make_patterns(plan, caps.size, caps.lattice))
        opened.camera.configure(opened.camera_settings(plan.exposure_s))
        spent = []
        for name in study.artefacts:
            opened.need_fixture("the benchmark").mount(name)
            _seconds_of_image(opened, 0)  # Blender starts, and takes in the scene
            spent += [_seconds_of_image(opened, i) for i in range(1, count + 1)]
    return fmean(spent)


def _seconds_of_image(rig: Rig, pattern: int) -> float:
    begin = time.perf_counter()
    rig.projector.show(pattern)
    rig.camera.snap()
    return time.perf_counter() - begin


def _scale(folder: Path, trial: OptimiseBenchmarkSetup) -> list[Result]:
    """Two workers against one, where there are two cores; and two of which one is killed."""
    study = _characterised(trial.search, trial.stripes, folder)
    factory = RigEvaluatorFactory(trial.search, study)
    tasks = [
        (one, study.seeds[0]) for one in candidates_like(Candidate.of(study.start), WARM + trial.measured)
    ]
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as claims:
        place = Path(claims)
        wanted, alone = timed_measurements(OnOneCore(factory, place / "one"), 1, tasks)
        results = []
        if (os.cpu_count() or 1) > 1:
            _, together = timed_measurements(OnOneCore(factory, place / "two"), 2, tasks)
            results.append(above("optimise_two_workers", alone / together, "of one's rate", LEAST_BY_TWO))
        found, _ = timed_measurements(KilledOnce(factory, place / "died"), 2, tasks)
    kept = sum(found.get(at) == outcome for at, outcome in wanted.items())
    return [*results, above("optimise_kept_of_killed", kept, "measurements", len(tasks))]
