"""The benchmark of optimisation, in the small: few pixels, one artefact, and searches that end soon."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from benchmarks import Result, above, below
from benchmarks.optimise import (
    OptimiseBenchmarkSetup,
    beside_singles,
    deviation,
    gain_of,
    groups_changed,
    no_worse,
    on_both,
    optimise_figures,
    own_cache,
    searched,
    wrong_percent,
)
from benchmarks.optimise_workers import WARM, KilledOnce
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.errors import DataError
from fpplab.core.session_names import CALIBRATION
from fpplab.core.system import cache_directory
from fpplab.optimisation.candidate import Candidate, seed_means
from fpplab.optimisation.confirm import Confirmation, ConfirmedPlan, RepeatedFigures
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.run import run_search
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.scoring import ArtefactFigures, TrueShape
from fpplab.patterns.fringe_sets import stepped_fringes
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import RIG, plain, write_world
from tests.support.searching import FRINGES, Formula, study

EPOCHS = 2
MEASURED = WARM + 4
POSITIONS = (-20.0, 0.0, 20.0)
STAGE = 'stage: {backend: "sim.devices:SimStage"}\n'
NAMES = ("phases", "stripes", "gradient", "baseline", "pareto")


def start(steps: int, *stripes: float, **more: Any) -> dict[str, Any]:
    return {"fringes": [{"axis": "x", "stripes": s, "steps": steps} for s in stripes], **more}


COORDINATE = {"kind": "coordinate", "first": 0.5, "finest": 0.5}
STRIPES = {"start": start(6, 1, 4, 16), "space": {"stripes": [None, None, [12, 96]]}}
STUDIES: dict[str, dict[str, Any]] = {
    "phases": {
        "start": start(12, 1, 8, 64),
        "space": {"steps": [None, None, [6, 24]]},
        "objectives": ["images"],
        "constraints": {"smcd_of_start": 1.2},
    },
    "stripes": STRIPES,
    "gradient": {**STRIPES, "method": {"kind": "gradient"}},
    "baseline": {
        "start": start(6, 1, 8, 32, stage_mm=0.0),
        "space": {"stage_mm": [POSITIONS[0], POSITIONS[-1]]},
    },
    "pareto": {
        "start": start(5, 1, 8, 32, stage_mm=0.0),
        "space": {"steps": [None, None, [4, 5]], "stripes": [None, None, [12, 96]]},
        "objectives": ["surface_smcd_um", "images"],
        "constraints": {"images": 15},
        "method": {"kind": "nsga2", "population": 4},
        "budget": 8,
    },
}


def written(folder: Path, rig: str, **changes: Any) -> str:
    """A small rig whose characterisations, the true ones, are there already."""
    place = folder / f"rig_{rig}"
    place.mkdir()
    world = World.load(write_world(place, plain(**changes)))
    text = RIG.replace("small virtual bench", rig).replace("world.yaml", str(place / "world.yaml"))
    (folder / f"rig_{rig}.yaml").write_text(text + STAGE)
    for name, mm in (("as_it_stands", 0.0), *((f"stage_{mm:+g}", mm) for mm in POSITIONS)):
        true = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(mm), {})
        (place / "board" / name).mkdir(parents=True)
        true.save(place / "board" / name / CALIBRATION)
    return str(folder / f"rig_{rig}.yaml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("optimisation")


@pytest.fixture(scope="module")
def trial(folder: Path) -> OptimiseBenchmarkSetup:
    common = {"artefacts": ["pillars"], "objectives": ["surface_smcd_um"], "seeds": [1, 2], "budget": 8}
    for name, changes in STUDIES.items():
        data = {"name": name, "method": COORDINATE, **common, **changes}
        (folder / f"study_{name}.yaml").write_text(config.to_yaml(data))
    return OptimiseBenchmarkSetup(
        search=written(folder, "search"),
        twin=written(folder, "twin"),
        hidden=written(folder, "hidden", seed=8),
        wide=written(folder, "wide"),
        **{name: str(folder / f"study_{name}.yaml") for name in NAMES},
        epochs=EPOCHS,
        rendered=1,
        measured=MEASURED - WARM,
        workers=1,
    )


@pytest.fixture(scope="module")
def results(folder: Path, trial: OptimiseBenchmarkSetup, blender: Blender) -> dict[str, Result]:
    """All figures; one Blender process renders, few points are compared, and workers measure a formula."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fpplab.optimisation.measuring.TrueShape", partial(TrueShape, density=2.0))
        patch.setattr("benchmarks.optimise.RigEvaluatorFactory", lambda rig, study: Formula())
        patch.setattr("sim.bench.Blender", lambda name: blender)
        patch.setattr(blender, "close", lambda: None)
        return {result.name: result for result in optimise_figures(folder, trial)}


@pytest.mark.nightly
def test_every_figure_stands_beside_its_target(results: dict[str, Result]) -> None:
    wanted = {
        "phases_images": 18, "phases_smcd": 1, "phases_smcd_hidden": 1,
        "stripes_down": 67, "stripes_down_hidden": 70,
        "stripes_wrong_orders": 0.1, "stripes_wrong_orders_hidden": 0.1,
        "baseline_down": 37, "baseline_down_moved": 37, "baseline_inside": 0.4,
        "pareto_plans": 12, "pareto_fewest": 9, "pareto_vs_single": 1, "pareto_hidden": 2,
        "gradient_epochs": EPOCHS, "gradient_seconds": 600, "vs_rendering_extrapolated": 100,
        "two_workers": 1.7, "kept_of_killed": MEASURED,
    }  # fmt: skip
    if os.cpu_count() == 1:
        del wanted["two_workers"]
    named = {f"optimise_{name}": target for name, target in wanted.items()}
    assert {name: result.baseline for name, result in results.items()} == pytest.approx(named)


@pytest.mark.nightly
def test_small_searches_find_what_there_is(results: dict[str, Result]) -> None:
    """Finer stripes; fewer images within the study's limit; a baseline at the end of its range.

    The twin is as the rig that is searched, the hidden bench has other noise.
    """
    value = {name.removeprefix("optimise_"): result.value for name, result in results.items()}
    assert value["phases_images"] < 36
    assert value["phases_smcd"] <= STUDIES["phases"]["constraints"]["smcd_of_start"]
    assert value["phases_smcd_hidden"] == pytest.approx(value["phases_smcd"], abs=0.1)
    assert value["stripes_down"] > 50
    assert value["stripes_down_hidden"] == pytest.approx(value["stripes_down"], abs=5)
    assert value["baseline_down_moved"] == pytest.approx(value["baseline_down"], abs=5)
    assert value["baseline_inside"] == 0
    assert value["pareto_plans"] == 2
    assert value["pareto_fewest"] == 14
    assert value["pareto_vs_single"] <= 1
    assert value["gradient_epochs"] == EPOCHS
    assert value["kept_of_killed"] == MEASURED
    for name in ("gradient_seconds", "vs_rendering_extrapolated"):
        assert value[name] > 0


@pytest.mark.nightly
@pytest.mark.usefixtures("results")
def test_a_search_that_has_ended_is_not_run_again(
    folder: Path, trial: OptimiseBenchmarkSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*asked: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr("fpplab.optimisation.measuring.RigEvaluator.measure", refused)
    found = searched(SearchScope.STRIPES, trial.search, trial.stripes, folder, 1)
    assert found.gain is not None


@pytest.mark.nightly
def test_plans_are_confirmed_side_by_side(
    folder: Path, trial: OptimiseBenchmarkSetup, results: dict[str, Result]
) -> None:
    """By processes of their own, which compare all points."""
    found = searched(SearchScope.STRIPES, trial.search, trial.stripes, folder, 1)
    ((twin, hidden),) = on_both(replace(trial, workers=2), found, folder)
    assert (twin.rig, hidden.rig) == ("twin", "hidden")
    for one, name in ((twin, "stripes_down"), (hidden, "stripes_down_hidden")):
        assert 100 * one.confirmation.gain == pytest.approx(results[f"optimise_{name}"].value, abs=2)


def test_what_a_figure_must_reach_and_what_it_must_not_exceed() -> None:
    assert above("it", 75.0, "%", 50.0) == Result("it", 75.0, "%", 50.0, 1.5)
    assert below("it", 75.0, "%", 50.0).ratio == pytest.approx(2 / 3)


@pytest.mark.parametrize(("gain", "ratio"), [(0.1, 1 / 0.88), (-0.02, 1.0), (-0.03, 1 / 1.01)])
def test_what_is_uncertain_is_in_favour_of_no_worse(gain: float, ratio: float) -> None:
    assert no_worse("it", confirmed(gain, 0.01).confirmation).ratio == pytest.approx(ratio)


def measured(**known: float) -> ArtefactFigures:
    names = ("points", "surface_smcd_um", "smcd_um", "smcd_floor_um", "surface_rms_um", "completeness")
    others = ("wrong_orders", "outliers", "surface_spread_um")
    return ArtefactFigures(**(dict.fromkeys((*names, *others), 0.0) | known))


def test_wrong_points_are_counted_not_averaged() -> None:
    few, many = (measured(points=n, wrong_orders=w) for n, w in ((100, 0.2), (900, 0.0)))
    assert wrong_percent({"pyramid": (few,), "steps": (many,)}) == pytest.approx(2.0)


def repeats(um: float) -> RepeatedFigures:
    return {"pyramid": (measured(surface_smcd_um=um),) * 2}


def confirmed(gain: float, uncertainty: float) -> ConfirmedPlan:
    """On a bench whose calibration alone is uncertain."""
    found = Confirmation(repeats(10.0), repeats(10.0 * (1.0 - gain)), uncertainty)
    return ConfirmedPlan("Bench", Path("plan.yaml"), 9, found)


def test_gains_deviate_by_so_many_of_both_their_uncertainties() -> None:
    assert deviation(confirmed(0.5, 0.03), confirmed(0.4, 0.04)) == pytest.approx(2.0)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> SearchResult:
    """A front of 13 to 19 images on a formula."""
    space = {"steps": [None, None, [3, 9]], "stage_mm": [-40, 40]}
    method = {"kind": "nsga2", "population": 8}
    start = {"fringes": [{**fringe, "steps": 5} for fringe in FRINGES], "stage_mm": 0.0}
    wanted = study(
        artefacts=["pyramid", "steps"],
        start=start,
        space=space,
        objectives=["surface_smcd_um", "images"],
        method=method,
    )
    out = tmp_path_factory.mktemp("front")
    return run_search(SearchScope.PARETO, "rig_demo", wanted, out, "study", factory=Formula(noise_um=1.0))


def test_a_front_is_held_against_plans_of_one_change(found: SearchResult) -> None:
    """The stage may move with the start's steps, or steps change where the stage stands."""
    changed = {t.candidate: groups_changed(found, t) for t in found.trials}
    assert changed[found.start.candidate] == set()
    assert set(map(frozenset, changed.values())) == {
        frozenset(), frozenset({"steps"}), frozenset({"geometry"}), frozenset({"steps", "geometry"}),
    }  # fmt: skip
    assert beside_singles(found) == pytest.approx(1.0)  # at the start's images only the stage counts
    worst = max(
        (t for t in found.trials if found.ranking.is_acceptable(t) and t.candidate.images == 15),
        key=lambda t: t.figures.surface_smcd_um,
    )
    best = min(
        t.figures.surface_smcd_um
        for t in found.trials
        if t.candidate.images == 15 and len(changed[t.candidate]) < 2
    )
    assert worst.figures.surface_smcd_um > best
    off = replace(found, front=(*found.front, worst))
    assert beside_singles(off) == pytest.approx(worst.figures.surface_smcd_um / best)


def test_the_gain_is_that_of_seeds_which_chose_nothing(found: SearchResult) -> None:
    before, after = (
        seed_means(found.rescored[trial.candidate]).values() for trial in (found.start, found.optimum)
    )
    assert gain_of(found) == pytest.approx(1 - sum(after) / sum(before))
    nothing = replace(found, rescored={**found.rescored, found.optimum.candidate: ()})
    with pytest.raises(DataError, match="could not be measured with other seeds"):
        gain_of(nothing)


def test_one_process_alone_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    killed: list[int] = []
    monkeypatch.setattr("psutil.Process.kill", lambda process: killed.append(process.pid))
    asked = Candidate((stepped_fringes("x", 1.0, 3), stepped_fringes("x", 4.0, 3)), 0.02), 1
    for _ in range(2):
        assert KilledOnce(Formula(), tmp_path / "died")().measure(*asked) == Formula()().measure(*asked)
        assert killed == [os.getpid()]


@pytest.mark.parametrize("before", ["/somewhere", None])
def test_a_cache_of_its_own_is_left_again(
    before: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if before is None:
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", before)
    with own_cache(tmp_path):
        assert cache_directory() == tmp_path / "fpplab"
    assert os.environ.get("XDG_CACHE_HOME") == before
