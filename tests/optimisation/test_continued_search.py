"""A search that is continued from its journal, ends by its budget, or meets what cannot be measured."""

import pickle
from pathlib import Path

import pytest

from fpplab.core import errors
from fpplab.core.errors import ConfigError, DataError, LimitError
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateRunner
from fpplab.optimisation.scheduling import InProcessWorkers, measure_outcome
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal
from tests.support.searching import (
    LIMITS,
    PHASES,
    Formula,
    runner_of,
    scores_of,
    search,
    study,
)


def test_killed_search_continues_from_its_journal(tmp_path: Path) -> None:
    whole = runner_of(tmp_path / "whole", Formula(noise_um=2.0))
    search(whole)
    journal = tmp_path / "whole" / "study.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    half = tmp_path / "half" / "study.jsonl"
    half.parent.mkdir()
    half.write_bytes(b"".join(lines[:21]) + lines[21][:40])  # the header, twenty, and a torn line
    log = tmp_path / "log"
    again = runner_of(tmp_path / "half", Formula(noise_um=2.0, log=log))
    search(again)
    assert half.read_bytes() == journal.read_bytes()
    assert len(log.read_text().splitlines()) == len(lines) - 21
    assert again.best == whole.best
    assert [t.candidate for t in again.trials] == [t.candidate for t in whole.trials]


def test_nothing_is_measured_twice(tmp_path: Path) -> None:
    log = tmp_path / "log"
    runner = runner_of(tmp_path, Formula(log=log))
    search(runner)
    assert len(log.read_text().splitlines()) == 2 * len(runner.trials)


def test_journal_of_another_study_is_refused(tmp_path: Path) -> None:
    runner_of(tmp_path).start  # noqa: B018 - measured for the journal
    with pytest.raises(ConfigError, match="'artefacts' is another"):
        Journal(tmp_path / "study.jsonl", study(artefacts=["ball"]), {})
    with pytest.raises(ConfigError, match="'rig' is another"):
        Journal(tmp_path / "study.jsonl", study(), {"name": "other"})
    assert len(Journal(tmp_path / "study.jsonl", study(budget=3, seeds=[5]), {})) == 2


def test_a_damaged_journal_is_refused(tmp_path: Path) -> None:
    runner_of(tmp_path).start  # noqa: B018 - measured for the journal
    path = tmp_path / "study.jsonl"
    path.write_text(path.read_text().replace('"points": 1000', '"points": "many"'))
    with pytest.raises(DataError, match=r"study\.jsonl line 2: is not a measurement"):
        Journal(path, study(), {})


def test_a_budget_is_kept(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, budget=9)
    with pytest.raises(BudgetExhausted):
        search(runner)
    assert 9 <= len(runner.trials) <= 9 + 6  # a round is always completed


def test_failed_candidate_does_not_end_the_search(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, Formula(fails_at=35), space=PHASES["space"])
    failed, fine = runner.measure([(11, 12, 12), (10, 12, 12)])
    assert failed.failed == "no pixel could be measured"
    assert fine.measured
    assert runner.best.measured
    again = runner_of(tmp_path, Formula(), space=PHASES["space"])
    assert again.measure([(11, 12, 12)])[0].failed == failed.failed


def test_infinite_score_is_a_failure() -> None:
    class Blind:
        def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
            return scores_of({("pyramid", 1): float("inf")})

        def close(self) -> None: ...

    assert measure_outcome(Blind(), Candidate((), 1.0), 1) == "nothing of the pyramid could be measured"


def test_failed_start_ends_the_search(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="the start of the study cannot be measured"):
        runner_of(tmp_path, Formula(fails_at=36)).start  # noqa: B018


def test_rig_fault_ends_the_search(tmp_path: Path) -> None:
    class Broken:
        def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
            raise LimitError("stage", "move_to", "stuck")

        def close(self) -> None: ...

    wanted = study()
    runner = CandidateRunner(
        SearchSpace.of(wanted, LIMITS, "s"),
        InProcessWorkers(Broken),
        Journal(tmp_path / "j.jsonl", wanted, {}),
    )
    with pytest.raises(LimitError):
        runner.measure([runner.space.start])


@pytest.mark.parametrize("kind", [errors.DeviceError, errors.LimitError, errors.DeviceTimeoutError])
def test_device_errors_can_be_pickled(kind: type[errors.DeviceError]) -> None:
    fault = kind("stage", "move_to", "70 mm was asked for", "the travel is 0 to 60 mm")
    copy = pickle.loads(pickle.dumps(fault))
    assert type(copy) is kind
    assert (str(copy), copy.device, copy.remedy) == (str(fault), "stage", fault.remedy)
