"""Scores that are predicted from bands of rows, beside whole measurements on the same simulated bench."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.errors import DataError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.run import journal_paths, run_search
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.screening import SampledEvaluator, can_screen
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets import stepped_fringes
from tests.support.searching import study

RIG = "rig_demo_quick"
SETS = [
    *({"axis": "x", "stripes": s, "steps": 4} for s in (1, 6, 24)),
    {"axis": "y", "stripes": 64, "steps": 3},
]
COARSE, FINE = (
    Candidate((*(stepped_fringes("x", s, 4) for s in (1, 6, finest)), stepped_fringes("y", 64, 3)), 0.02)
    for finest in (24, 60)
)


@pytest.fixture(scope="module")
def wanted(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A small study with the exact calibration of the rig."""
    file = tmp_path_factory.mktemp("known") / "calibration.yaml"
    with Rig.load(RIG) as rig:
        assert isinstance(rig.simulation, Predictable)
        rig.simulation.image_part_sampler().calibration.save(file)
    return study(
        artefacts=["pyramid", "steps"],
        start={"fringes": SETS, "guided_axis": "y", "exposure_s": 0.02, "filter": {}},
        space={"stripes": [None, None, [16, 64], None]},
        calibrations=[{"file": str(file)}],
        method={"kind": "coordinate", "first": 0.5, "finest": 0.25},
        budget=3,
        screening=True,
    )


@pytest.fixture(scope="module")
def evaluator(wanted: Study) -> Iterator[SampledEvaluator]:
    with closing(SampledEvaluator(RIG, wanted)) as opened:
        yield opened


@pytest.mark.whole
def test_predicted_scores_are_those_of_whole_measurements(wanted: Study, evaluator: SampledEvaluator) -> None:
    with closing(RigEvaluator(RIG, wanted)) as whole:
        for candidate in (COARSE, FINE):
            for seen, true in zip(evaluator.measure(candidate, 1), whole.measure(candidate, 1), strict=True):
                assert (seen.artefact, seen.seed, seen.images) == (true.artefact, true.seed, true.images)
                assert seen.seconds == true.seconds
                assert seen.surface_smcd_um == pytest.approx(true.surface_smcd_um, rel=0.06)
                assert seen.surface_rms_um == pytest.approx(true.surface_rms_um, rel=0.1)
                assert seen.completeness == pytest.approx(true.completeness, abs=0.02)
                assert seen.points < 0.2 * true.points


@pytest.mark.whole
def test_several_exposures_are_predicted_and_measured(wanted: Study, evaluator: SampledEvaluator) -> None:
    """Twice at nearly the same exposure, a quarter less noise, in twice the time."""
    twice = replace(FINE, exposures_s=(0.0199, 0.0201))
    once, both = (evaluator.measure(each, 1)[0] for each in (FINE, twice))
    with closing(RigEvaluator(RIG, wanted)) as whole:
        measured, alone = (whole.measure(each, 1)[0] for each in (twice, FINE))
    for several, single in ((both, once), (measured, alone)):
        assert several.surface_rms_um == pytest.approx(single.surface_rms_um / np.sqrt(2), rel=0.15)
        assert several.seconds == pytest.approx(2.0 * single.seconds)


@pytest.mark.whole
def test_a_seed_gives_the_same_scores_again_and_another_seed_others(evaluator: SampledEvaluator) -> None:
    first = evaluator.measure(FINE, 1)
    evaluator.measure(COARSE, 1)
    assert evaluator.measure(FINE, 1) == first
    assert evaluator.measure(FINE, 2)[0].surface_smcd_um != first[0].surface_smcd_um


@pytest.mark.whole
def test_nothing_lit_is_an_error_and_no_score(evaluator: SampledEvaluator) -> None:
    dark = Candidate(COARSE.fringes, 2e-5)
    with pytest.raises(DataError):
        evaluator.measure(dark, 1)


@pytest.mark.whole
def test_stripes_that_the_depth_range_does_not_unwrap_are_told(wanted: Study) -> None:
    start = wanted.start.model_copy(update={"depth_mm": (300.0, 700.0)})
    unclear = Candidate(tuple(stepped_fringes("x", stripes, 4) for stripes in (30, 60)), 0.02)
    deep = {"start": start}
    words = []
    for kind in (SampledEvaluator, RigEvaluator):
        with closing(kind(RIG, wanted.model_copy(update=deep))) as opened, pytest.raises(DataError) as error:
            opened.measure(unclear, 1)
        words.append(str(error.value)[:40])
    assert words[0] == words[1]
    assert "nothing of" not in words[0]


def test_what_moves_and_what_is_no_simulation_is_measured(wanted: Study) -> None:
    moving = study(screening=True, space={"stripes": [None, None, [16, 64]], "stage_mm": [-40, 40]})
    with Rig.load(RIG) as rig:
        assert can_screen(rig, wanted)
        assert not can_screen(rig, moving)
        assert not can_screen(rig, wanted.model_copy(update={"screening": False}))
    with Rig.load("rig_emulated_quick") as rig:
        assert not can_screen(rig, wanted)


@pytest.mark.whole
def test_a_screened_search_measures_the_start_and_what_it_has_found(wanted: Study, tmp_path: Path) -> None:
    out = tmp_path / "found.yaml"
    found = run_search(SearchScope.STRIPES, RIG, wanted, out, "study")
    assert found.screened
    assert found.optimum.candidate.fringes[2].stripes > 24
    measured, predicted = (path.read_text().splitlines() for path in journal_paths(SearchScope.STRIPES, out))
    assert len(predicted) == 1 + len(found.trials) * len(wanted.seeds)
    assert len(measured) == 1 + 2 * len(wanted.seeds)  # start and optimum, with other seeds
    again = found.rescored[found.optimum.candidate]
    assert {score.seed for score in again} == {3, 4}
    distance = np.mean([score.surface_smcd_um for score in again])
    assert distance == pytest.approx(found.optimum.figures.surface_smcd_um, rel=0.06)
    assert f"{distance:.2f} µm mean distance" in out.read_text().splitlines()[0]
    assert Candidate.of(config.load_document(out, type(wanted.start))) == found.optimum.candidate


@pytest.mark.whole
def test_seeds_draw_the_twin_within_its_uncertainty(wanted: Study, tmp_path: Path) -> None:
    """Blur that is not known well spreads what seeds predict; otherwise their spread is the noise's."""

    def spread(sigma: float) -> float:
        world = config.find_config("world_demo", "world")
        data = config.parse_yaml(world.read_text(), world)
        data["uncertainty"] = {"projector.blur": sigma} if sigma else {}
        (tmp_path / "world.yaml").write_text(config.to_yaml(data))
        file = config.find_config(RIG, "rig")
        rig = config.parse_yaml(file.read_text(), file)
        rig["bench"]["world"] = str(tmp_path / "world.yaml")
        (tmp_path / "rig.yaml").write_text(config.to_yaml(rig))
        with closing(SampledEvaluator(str(tmp_path / "rig.yaml"), wanted)) as opened:
            return float(np.std([opened.measure(FINE, seed)[0].surface_smcd_um for seed in range(1, 5)]))

    assert spread(0.5) > 3 * spread(0.0)
