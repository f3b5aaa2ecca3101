"""A whole search from study to plans and report, on a formula within the limits of a rig file."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError, LimitError
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.candidate_runner import SearchEpoch
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.run import run_search, worker_count
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.study import Study
from fpplab.optimisation.verdict import diagnose_search
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.report.optimisation import write_optimisation_report
from fpplab.results.search import OptimisationResult
from fpplab.sessions.session import Session
from fpplab.viewer.canvas import Canvas
from fpplab.viewer.search import SearchView
from tests.support.searching import FRINGES, LIMITS, Formula, study

ITEMS = ["pyramid", "steps"]
START = {"fringes": [{**fringe, "steps": 5} for fringe in FRINGES], "stage_mm": 0.0}
FRONT: dict[str, Any] = {
    "artefacts": ITEMS,
    "start": START,
    "space": {"steps": [None, None, [3, 9]], "stage_mm": [-40, 40]},
    "objectives": ["surface_smcd_um", "images"],
    "method": {"kind": "nsga2", "population": 8},
}


def searched(what: SearchScope, wanted: Study, out: Path, **more: Any) -> SearchResult:
    return run_search(what, "rig_demo", wanted, out, "study.yaml", factory=Formula(noise_um=1.0), **more)


@pytest.mark.whole
def test_front_is_written_as_a_folder_of_plans(tmp_path: Path) -> None:
    seen: list[SearchEpoch] = []
    found = searched(SearchScope.PARETO, study(**FRONT), tmp_path / "front", observe=seen.append)
    assert [p.name for p in found.plans] == [
        f"plan_{i:02d}_{n}images.yaml" for i, n in enumerate(range(19, 12, -1), 1)
    ]
    for path, trial in zip(found.plans, found.front, strict=True):
        assert Plan.load(path) == trial.candidate.plan(found.study.start)
        assert Plan.load(path).stage_mm == pytest.approx(20.0, abs=2.0)
    summary = found.summary()
    assert summary["epochs"] == len(seen) == len(summary["convergence"])
    assert [one["images"] for one in summary["front"]] == list(range(19, 12, -1))
    page = tmp_path / "page.html"
    write_optimisation_report(page, OptimisationResult(found, diagnose_search(found), page))
    page = (tmp_path / "page.html").read_text()
    for words in ("Pareto front", "Convergence", "Distance against steps[2]", "Shadow against stage_mm"):
        assert words in page


def test_gain_is_measured_with_seeds_unused_by_the_search(tmp_path: Path) -> None:
    log = tmp_path / "log"
    wanted = study(artefacts=ITEMS, seeds=[3, 7])
    found = run_search(
        SearchScope.STRIPES,
        "rig_demo",
        wanted,
        tmp_path / "p.yaml",
        "s",
        factory=Formula(log=log, noise_um=1.0),
    )
    seeds = [int(line.split()[1]) for line in log.read_text().splitlines()]
    assert set(seeds) == {3, 7, 8, 9}
    assert seeds.count(8) == seeds.count(9) == 2  # of the start and of the optimum
    assert found.gain is not None
    # The noise is one for all candidates, so the gain has none.
    assert found.gain.down_um == pytest.approx(
        found.start.figures.surface_smcd_um - found.optimum.figures.surface_smcd_um, abs=1e-9
    )
    assert found.gain.uncertainty_um == pytest.approx(0.0, abs=1e-9)


def test_search_without_acceptable_plan_is_an_error(tmp_path: Path) -> None:
    wanted = study(artefacts=ITEMS, constraints={"smcd_of_start": 0.5}, budget=40)
    with pytest.raises(DataError, match="keeps the study's limits; the best breaks surface_smcd_um by"):
        searched(SearchScope.STRIPES, wanted, tmp_path / "p.yaml")
    assert not (tmp_path / "p.yaml").exists()
    assert (tmp_path / "p.jsonl").exists()


@pytest.mark.parametrize(
    ("what", "changes", "words"),
    [
        (
            SearchScope.PHASES,
            {"artefacts": ITEMS},
            r"searches stripes\[1\], stripes\[2\], which `optimise phases`",
        ),
        (SearchScope.PARETO, {"artefacts": ITEMS}, "'objectives' must name several"),
        (SearchScope.STRIPES, {"artefacts": ["ball"]}, "'artefacts' names 'ball', and the fixture of rig"),
        (SearchScope.STRIPES, {"artefacts": ITEMS, "rig": "Bench 7"}, "'rig' is 'Bench 7'"),
    ],
)
def test_study_for_another_scope_or_rig_is_refused(
    tmp_path: Path, what: SearchScope, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        searched(what, study(**changes), tmp_path / "p.yaml")


def test_plan_found_keeps_other_settings_of_the_start(tmp_path: Path) -> None:
    start = {"fringes": FRINGES, "filter": None, "settle_s": 0.05, "masks": {"modulation_min": 7.0}}
    wanted = study(artefacts=ITEMS, start=start, constraints={"completeness_of_start": 0.9}, budget=12)
    found = searched(SearchScope.STRIPES, wanted, tmp_path / "p.yaml")
    written = Plan.load(tmp_path / "p.yaml")
    assert written == found.optimum.candidate.plan(wanted.start)
    assert written.filter is None
    assert written.masks.modulation_min == 7.0


@pytest.mark.whole
def test_search_is_shown_in_the_viewer(tmp_path: Path) -> None:
    with Canvas(file=tmp_path / "search.rrd") as canvas:
        searched(
            SearchScope.BASELINE,
            study(artefacts=ITEMS, space={"stage_mm": [-40, 40]}),
            tmp_path / "p.yaml",
            observe=SearchView(canvas).epoch,
        )
    assert (tmp_path / "search.rrd").stat().st_size > 1000


def test_plan_sets_the_stage_position(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = config.validate({"fringes": FRINGES, "stage_mm": 12.5}, Plan, "plan.yaml")
    stood: list[float] = []

    def acquired(rig: Rig, *others: object) -> None:
        assert rig.stage is not None
        stood.append(rig.stage.position_mm)

    monkeypatch.setattr("fpplab.pipeline.taking.acquire", acquired)
    with Rig.load("rig_demo_quick") as rig:
        take_or_resume_session(rig, plan, tmp_path / "s")
        with pytest.raises(LimitError, match="the travel is -60 to 60 mm"):
            rig.place_stage(61.0)
    assert stood == [12.5]


def test_session_is_kept_when_the_stage_position_is_out_of_range(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = config.validate({"fringes": FRINGES, "stage_mm": 12.5}, Plan, "plan.yaml")
    monkeypatch.setattr("fpplab.pipeline.taking.acquire", lambda *others: None)
    with Rig.load("rig_demo_quick") as rig:
        take_or_resume_session(rig, plan, tmp_path / "s")
        for beyond in (61.0, -61.0):
            with pytest.raises(LimitError, match="the travel is -60 to 60 mm"):
                take_or_resume_session(
                    rig, plan.model_copy(update={"stage_mm": beyond}), tmp_path / "s", replace_existing=True
                )
    assert Session.open(tmp_path / "s").plan == plan


@pytest.mark.parametrize(
    ("stands", "wanted"), [(None, [-40, 0, 40]), ([-40.0, -30.0], [-40, 0]), ([20.0], [0, 20]), ([0.0], [0])]
)
def test_rig_is_characterised_at_the_ends_of_its_stage_positions(
    stands: list[float] | None, wanted: list[float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[float]] = []

    def characterised(rig: Rig, positions: list[float], *others: object) -> dict[float, Path]:
        asked.append(positions)
        return {mm: tmp_path / f"{mm:g}.yaml" for mm in positions}

    monkeypatch.setattr("fpplab.optimisation.arrangement.characterise_positions", characterised)
    with Rig.load("rig_demo_quick") as rig:
        known = with_calibrations(rig, study(**FRONT), tmp_path, stage_positions=stands).calibrations
    assert asked == [wanted]
    assert [(one.stage_mm, one.file) for one in known] == [
        (mm, str((tmp_path / f"{mm:g}.yaml").resolve())) for mm in wanted
    ]


def test_stage_position_without_a_stage_is_refused() -> None:
    with Rig.load("rig_demo_quick") as rig:
        rig.stage = None
        with pytest.raises(ConfigError, match="'stage' is missing, and the plan's stage_mm 5 needs one"):
            rig.place_stage(5.0)


@pytest.mark.parametrize(
    ("copies", "gigabytes", "wanted", "count"),
    [(True, 40, None, 8), (True, 9, None, 2), (True, 1, None, 1), (True, 1, 5, 5), (False, 30, None, 1)],
)
def test_worker_count_follows_cores_and_memory_on_a_simulation(
    copies: bool, gigabytes: int, wanted: int | None, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=gigabytes << 30))
    assert worker_count(replace(LIMITS, allows_copies=copies), wanted) == count


def test_real_rig_is_measured_by_one_process() -> None:
    assert worker_count(LIMITS, 1) == 1
    with pytest.raises(ConfigError, match="--workers 2: rig 'Formula' is no simulation"):
        worker_count(LIMITS, 2)
