"""Pattern images from files: what a plan keeps of them, and what is refused."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan

SIZE = 24, 16


def plan_with(folder: Path, **entry: Any) -> Path:
    path = folder / "plan.yaml"
    path.write_text(config.to_yaml({"fringes": [{"kind": "files", "axis": "x", **entry}]}))
    return path


@pytest.mark.parametrize("axis", ["x", "y"])
def test_patterns_are_those_of_the_files_also_without_them(tmp_path: Path, axis: str) -> None:
    random, (width, height) = np.random.default_rng(1), SIZE
    images = []
    for k in range(3):
        length = width if axis == "x" else height
        levels = random.integers(0, 256, length, np.uint8)
        images.append(np.tile(levels, (height, 1)) if axis == "x" else np.tile(levels[:, None], width))
        cv2.imwrite(str(tmp_path / f"{k}.png"), images[-1])
    plan = Plan.load(plan_with(tmp_path, axis=axis, names=[f"{k}.png" for k in range(3)]))
    for k in range(3):
        (tmp_path / f"{k}.png").unlink()
    again = config.validate(config.parse_yaml(config.dump(plan), "plan"), Plan, "plan")
    assert again == plan
    for pattern, image in zip(make_patterns(again, SIZE, Lattice.SQUARE), images, strict=True):
        np.testing.assert_array_equal(pattern.image, image)
    with pytest.raises(
        ConfigError, match=rf"0.png has {len(images[0][0] if axis == 'x' else images[0])} pixels"
    ):
        plan.check_projector((30, 30), "plan")


def test_what_is_no_code_of_an_axis_is_refused(tmp_path: Path) -> None:
    ramp = np.tile(np.arange(SIZE[0], dtype=np.uint8), (SIZE[1], 1))
    images = {
        "across.png": (ramp + np.arange(SIZE[1], dtype=np.uint8)[:, None], "changes across its axis x too"),
        "coloured.png": (np.stack([ramp, ramp, ramp + 1], axis=-1), "is coloured"),
        "deep.png": (ramp.astype(np.uint16), "8-bit grey levels"),
    }
    for name, (image, _) in images.items():
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "text.png").write_text("no image")
    expected = {name: reason for name, (_, reason) in images.items()}
    for name, reason in {**expected, "text.png": "8-bit grey levels", "none.png": "no such file"}.items():
        with pytest.raises(ConfigError, match=f"{name}.*{reason}"):
            Plan.load(plan_with(tmp_path, names=[name]))
    with pytest.raises(ConfigError, match=r"'fringes\[0\].levels' .*is not what loading a plan writes"):
        Plan.load(plan_with(tmp_path, names=["a.png"], levels=["nonsense"]))
