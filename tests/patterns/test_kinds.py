"""A new kind of fringe set, and a new unwrapping method, need one class each, defined in this file."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.unwrapping import unwrapping_methods

ROOT = Path(__file__).parents[2]
NEW_KIND = '''
"""Sinusoids whose images are shown in any order of their shifts, against lamps that drift."""

from typing import Literal

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets.base import Demodulation, FringeSet


class Reordered(FringeSet):
    kind: Literal["reordered"] = "reordered"
    order: tuple[int, ...]

    @property
    def images(self) -> int:
        return len(self.order)

    def phase_shifts(self) -> Floats:
        return 2 * np.pi * np.array(self.order) / self.images

    def wave(self, phase: Floats, step: int) -> Floats:
        return 0.5 + 0.5 * np.cos(phase - self.phase_shifts()[step])

    def demodulation(self) -> Demodulation:
        shift, n = self.phase_shifts(), self.images
        return Demodulation(np.sin(shift), np.cos(shift), np.full(n, 1 / n), 2 / n, 0.0)
'''
NEW_METHOD = '''
"""Uses the sets as they are, under another name."""

from fpplab.patterns.unwrapping.hierarchical import Hierarchical


class Renamed(Hierarchical):
    name = "renamed"
'''
TRIAL = '''
import numpy as np
from fpplab import Plan, Recording, decode
from fpplab.acquisition.synchronisation import check_synchronisation
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.patterns.fringes import make_patterns

text = """
fringes:
  - {axis: x, stripes: 1, steps: 4}
  - {kind: reordered, axis: x, stripes: 7, order: [3, 0, 4, 1, 5, 2]}
  - {kind: reordered, axis: x, stripes: 40, order: [1, 0, 3, 2, 4]}
unwrapping: METHOD
"""
plan = config.validate(config.parse_yaml(text, "plan"), Plan, "plan")
assert config.validate(config.parse_yaml(config.dump(plan), "plan"), Plan, "plan") == plan
size = (400, 48)
frames = [pattern.image for pattern in make_patterns(plan, size, Lattice.SQUARE)]
assert check_synchronisation(Recording(frames, plan, size)).in_step
late = [frames[-1], *frames[:-1]]
assert not check_synchronisation(Recording(late, plan, size)).in_step
rules = plan.masks.model_copy(update={"contrast_min": 0.0})
bright = [(20 + 0.8 * frame).astype(np.uint8) for frame in frames]
decoded = decode(Recording(bright, plan.model_copy(update={"masks": rules}), size))
assert decoded.valid.mean() > 0.99, decoded.valid.mean()
error = np.abs(decoded.u - np.arange(400))[decoded.valid]
assert error.max() < 0.1, error.max()
print("ok")
'''


NEW_CODE = '''
"""Reflected code of three levels, which needs fewer images than one of two."""

from typing import Literal

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets.base import CodeSet


class Ternary(CodeSet):
    """Digits of a reflected code of base three, coarsest first."""

    kind: Literal["ternary"] = "ternary"
    digits: int
    """How many digits, each with an image."""

    @property
    def images(self) -> int:
        return self.digits

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        cell = np.floor(coordinate + 0.5).astype(int) // 3 ** (self.digits - 1 - step)
        return np.where(cell // 3 % 2, 2 - cell % 3, cell % 3) / 2

    @property
    def short_name(self) -> str:
        return f"ternary{self.digits}"
'''
CODE_TRIAL = """
import numpy as np
from fpplab import Plan, Recording, decode
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.patterns.fringes import make_patterns
from fpplab.report.figures import pattern_sheet

text = "fringes: [{kind: even, levels: [1, 0]}, {kind: ternary, axis: x, digits: 5}]"
plan = config.validate(config.parse_yaml(text, "plan"), Plan, "plan")
size, random = (240, 48), np.random.default_rng(6)
patterns = make_patterns(plan, size, Lattice.SQUARE)
light = [20 + 0.8 * pattern.image + random.normal(0, 2, pattern.image.shape) for pattern in patterns]
decoded = decode(Recording([np.rint(image).astype(np.uint8) for image in light], plan, size))
assert decoded.valid[:, 2:-2].mean() > 0.99, decoded.valid.mean()
assert np.abs(decoded.u - np.arange(240))[decoded.valid].max() <= 1.0
assert patterns[3].id == "01-x-ternary5-001of5"
assert len(pattern_sheet(patterns)) > 1000
described = Plan.model_json_schema()["$defs"]["Ternary"]
assert described["description"].startswith("Digits of a reflected code"), described
assert described["properties"]["digits"]["description"] == "How many digits, each with an image."
print("ok")
"""


def copy_of_fpplab(folder: Path, added: dict[str, str]) -> None:
    # With the compiled functions, which are as valid in a copy whose files are as old as these.
    shutil.copytree(ROOT / "fpplab", folder / "fpplab", ignore=shutil.ignore_patterns("*.pyc"))
    for name, text in added.items():
        (folder / "fpplab" / "patterns" / name).write_text(text, encoding="utf-8")


def tried(folder: Path, added: dict[str, str], trial: str) -> None:
    copy_of_fpplab(folder, added)
    done = subprocess.run(
        [sys.executable, "-c", trial], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.stdout == "ok\n", done.stderr


@pytest.mark.whole
@pytest.mark.parametrize("method", ["hierarchical", "renamed"])
def test_a_new_kind_is_one_file(tmp_path: Path, method: str) -> None:
    added = {"fringe_sets/reordered.py": NEW_KIND, "unwrapping/renamed.py": NEW_METHOD}
    tried(tmp_path, added, TRIAL.replace("METHOD", method))


@pytest.mark.whole
def test_a_new_code_is_one_file(tmp_path: Path) -> None:
    tried(tmp_path, {"fringe_sets/ternary.py": NEW_CODE}, CODE_TRIAL)


def test_a_sinusoid_needs_no_kind_and_tells_none() -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=4),))
    assert "kind" not in config.dump(plan)
    named = {"fringes": [{"kind": "sinusoid", "axis": "x", "stripes": 1, "steps": 4}]}
    assert config.validate(named, Plan, "plan") == plan


def test_an_unknown_kind_lists_the_known() -> None:
    wrong = {"fringes": [{"kind": "grey", "axis": "x", "stripes": 1, "steps": 4}]}
    kinds = ".*, ".join(["even", "files", "gray", "modulated", "shifted", "sinusoid"])
    with pytest.raises(ConfigError, match=rf"'fringes\[0\]' .*must have a 'kind' of {kinds}"):
        config.validate(wrong, Plan, "plan")


def test_a_list_of_wrong_entries_is_not_called_too_short() -> None:
    wrong = {"fringes": [{"axis": "x", "stripes": 1, "steps": 2}]}
    with pytest.raises(ConfigError, match=r"^plan: 'fringes\[0\].steps' is 2: [^;]*$"):
        config.validate(wrong, Plan, "plan")
    with pytest.raises(ConfigError, match=r"'fringes' is \[\]: Tuple should have at least 1 item"):
        config.validate({"fringes": []}, Plan, "plan")


def test_an_unknown_method_lists_the_known() -> None:
    assert sorted(unwrapping_methods()) == ["guided", "heterodyne", "hierarchical", "spatial"]
    wrong = {"fringes": [{"axis": "x", "stripes": 1, "steps": 4}], "unwrapping": "magic"}
    with pytest.raises(ConfigError, match="'unwrapping' is 'magic': should be 'spatial' or 'hierarchical'"):
        config.validate(wrong, Plan, "plan")
