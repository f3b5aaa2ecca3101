"""Objectives as plug-ins: one file adds one, and study files, limits and reports know it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fpplab
from docs.generate.reference import files_page
from fpplab.core.errors import ConfigError
from fpplab.optimisation.objective import registered_objectives
from tests.support.searching import study

ROOT = Path(__file__).parents[2]
SUPPLIED = {
    "completeness": "completeness_of_start",
    "images": None,
    "seconds": "seconds",
    "surface_rms_um": None,
    "surface_smcd_um": "smcd_of_start",
    "worst_smcd_um": None,
}
"""The objectives that come with fpplab, and the fields of a study that limit them."""
LIGHT = '''
from typing import Annotated

from pydantic import Field

from fpplab.optimisation.candidate import MeasuredCandidate
from fpplab.optimisation.objective import Objective, ObjectiveLimit


class Light(Objective):
    """Time for which the projector shines on the part."""

    key = "light_s"
    title = "Light on the part"
    unit = "s"
    sentence = "time for which the projector shines on the part"
    limit = ObjectiveLimit("light_s", Annotated[float, Field(gt=0)] | None, None, "Longest time of light.")

    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.candidate.images * candidate.candidate.exposure_s

    def excess(self, value: float, of_start: float, limit: float) -> float:
        return value / limit - 1.0
'''
USE = """
import pickle
from pathlib import Path
from docs.generate.reference import files_page
from fpplab.core.errors import ConfigError
from fpplab.optimisation.run import run_search
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.verdict import diagnose_search
from fpplab.report.optimisation import write_optimisation_report
from fpplab.results.search import OptimisationResult
from tests.support.searching import Formula, study

ITEMS = ["pyramid", "steps"]
wanted = study(
    artefacts=ITEMS, space={"steps": [None, None, [3, 12]]}, objectives=["surface_smcd_um", "light_s"],
    method={"kind": "nsga2", "population": 6}, constraints={"light_s": 0.7},
)
assert pickle.loads(pickle.dumps(wanted)) == wanted
found = run_search(SearchScope.PARETO, "rig_demo", wanted, Path("front"), "study.yaml", factory=Formula())
answer = found.summary()
print(answer["initial"]["light_s"], max(trial["light_s"] for trial in answer["front"]))
page = Path("page.html")
write_optimisation_report(page, OptimisationResult(found, diagnose_search(found), page))
print("Light on the part, s" in Path("page.html").read_text())
page = files_page()
print("time for which the projector shines" in page, "Longest time of light." in page)
try:
    study(constraints={"light_s": 0.0})
except ConfigError as error:
    print(error)
"""


@pytest.mark.whole
def test_one_file_adds_an_objective(tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__")
    package = shutil.copytree(Path(fpplab.__file__).parent, tmp_path / "fpplab", ignore=ignored)
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    (package / "optimisation" / "objectives" / "light.py").write_text(LIGHT)
    done = subprocess.run(
        [sys.executable, "-c", USE],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    values, in_report, in_reference, refused = done.stdout.splitlines()
    assert values == "0.72 0.68"  # 36 images at first; 35 would take 0.7 s and a rounding error
    assert (in_report, in_reference) == ("True", "True True")
    assert refused.startswith("study.yaml: 'constraints.light_s' is 0.0: should be greater than 0")


def test_every_objective_is_described_and_keeps_its_limit_apart() -> None:
    objectives = registered_objectives()
    page = files_page()
    for key, objective in objectives.items():
        assert f"`{key}`: {objective.sentence}" in page
        assert not objective.sentence.endswith(".")
    limits = {
        key: objective.limit.key for key, objective in objectives.items() if objective.limit is not None
    }
    assert {key: limits.get(key) for key in SUPPLIED if key in objectives} == SUPPLIED
    assert len({*limits.values()}) == len(limits)


def test_an_unknown_objective_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        ConfigError, match=r"'objectives\[0\]' is 'beauty': must be one of .*\bcompleteness, images, "
    ):
        study(objectives=["beauty"])
