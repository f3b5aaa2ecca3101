"""Search methods as plug-ins: one file adds a method, and study files stay as they are."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fpplab
from fpplab.core.errors import ConfigError
from fpplab.core.tagged_union import registered_types
from fpplab.optimisation.search_method import SearchMethod
from tests.support.searching import study

ROOT = Path(__file__).parents[2]
RANDOM_SEARCH = '''
from __future__ import annotations

import random
from typing import TYPE_CHECKING, Literal

from fpplab.optimisation.search_method import SearchMethod

if TYPE_CHECKING:
    from fpplab.optimisation.candidate_runner import CandidateRunner


class RandomSearch(SearchMethod):
    """Points drawn uniformly."""

    kind: Literal["random"] = "random"
    count: int = 10

    def search(self, runner: CandidateRunner) -> str:
        drawn = random.Random(0)
        points = [
            tuple(p.value_at(drawn.random()) for p in runner.space.parameters) for _ in range(self.count)
        ]
        runner.epoch("random", runner.measure(points))
        return "every point was measured"
'''
USE = """
from pathlib import Path
from fpplab.core.errors import ConfigError
from fpplab.optimisation.run import _run_search_method
from tests.support.searching import runner_of, study

runner = runner_of(Path(), method={"kind": "random", "count": 7})
ended = _run_search_method(runner, runner.space.problem.method)
print(*ended, len(runner.epochs), 1 < len(runner.trials) <= 8)
try:
    study(method={"kind": "random", "count": "many"})
except ConfigError as error:
    print(error)
"""


@pytest.mark.whole
def test_one_file_adds_a_method(tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__")
    package = shutil.copytree(Path(fpplab.__file__).parent, tmp_path / "fpplab", ignore=ignored)
    (package / "optimisation" / "methods" / "random_search.py").write_text(RANDOM_SEARCH)
    done = subprocess.run(
        [sys.executable, "-c", USE],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ended, refused = done.stdout.splitlines()
    assert ended == "every point was measured False 2 True"
    assert refused.startswith("study.yaml: 'method.count' is 'many'")


def test_methods_are_known_by_their_kind() -> None:
    assert list(registered_types(SearchMethod)) == ["bayesian", "coordinate", "gradient", "nsga2"]


@pytest.mark.parametrize("method", [{"kind": "luck"}, {"first": 0.5}, {"kind": ["gradient"]}])
def test_an_unknown_method_is_refused(method: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"'method' is .*bayesian, coordinate, gradient, nsga2"):
        study(method=method)


def test_a_method_is_stored_with_all_of_its_settings() -> None:
    plain = study(method={"kind": "gradient", "rate": 0.1}).model_dump(mode="json")["method"]
    expected = {"kind": "gradient", "rate": 0.1, "difference": 0.02, "gain": 1.0, "patience": 5}
    assert plain == expected
    assert list(plain) == list(expected)
