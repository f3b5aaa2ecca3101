"""The artefacts are closed bodies of known volume, placed as the twin expects them."""

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fpplab import artefacts
from fpplab.artefacts import catalogue, shapes
from fpplab.artefacts.shapes.pillars import PILLAR_CORNERS, Pillars
from fpplab.artefacts.shapes.pyramid import Pyramid
from fpplab.artefacts.shapes.steps import Staircase
from fpplab.cli.every import app
from fpplab.clouds import load_mesh
from fpplab.core.errors import ConfigError

POLYGON = PILLAR_CORNERS / 2 * np.sin(2 * np.pi / PILLAR_CORNERS)
"""Area of the pillars' outline for a radius of one."""


SUPPLIED = ("pyramid", "pillars", "steps")
"""The artefacts that come with fpplab, in their order."""


def expected_volume(name: str) -> float:
    if name == "steps":
        return 90.0 * 70.0 / 5 * (5 + 10 + 15 + 20 + 25)
    if name == "pyramid":  # a plate and a prismatoid whose sides go in by the same share
        foot, top = 80.0 * 60.0, 8.0 * 6.0
        return 90 * 70 * 5 + 20.0 / 3 * (foot + top + np.sqrt(foot * top))
    standing = [(d / 2) ** 2 * (h + i - 5) for i, d in enumerate((6, 9, 12, 15)) for h in (9, 15, 21)]
    return 90 * 70 * 5 + POLYGON * sum(standing)


@pytest.mark.parametrize("name", artefacts.artefact_types())
def test_artefact_is_one_closed_body_facing_outwards(name: str) -> None:
    mesh = artefacts.make(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.area_faces.min() > 0.0
    assert mesh.volume > 0.0


@pytest.mark.parametrize("name", SUPPLIED)
def test_artefact_has_the_volume_of_its_lengths(name: str) -> None:
    assert artefacts.make(name).volume == pytest.approx(expected_volume(name), rel=1e-9)


@pytest.mark.parametrize("name", SUPPLIED)
def test_artefact_stands_on_its_base_in_the_middle(name: str) -> None:
    low, high = artefacts.make(name).bounds
    assert low == pytest.approx([-45.0, -35.0, 0.0])
    assert high[:2] == pytest.approx([45.0, 35.0])
    assert 20.0 <= high[2] <= 25.0


CUBE = '''"""The cube."""

from dataclasses import dataclass

from fpplab.artefacts.base import Artefact


@dataclass(frozen=True)
class Cube(Artefact):
    """A cube."""

    side: float = 20.0

    def check_lengths(self):
        """Any side will do."""

    def mesh(self):
        """A box on z = 0."""
        import trimesh

        box = trimesh.creation.box((self.side,) * 3)
        return box.apply_translation((0.0, 0.0, self.side / 2))
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose files count as artefacts as those of the package do."""
    with monkeypatch.context() as patch:
        patch.setattr(shapes, "__path__", [*shapes.__path__, str(tmp_path)])
        yield tmp_path
    for name in ("added_cube", "two"):
        sys.modules.pop(f"{shapes.__name__}.{name}", None)
    importlib.reload(catalogue)


def test_names_are_in_the_order_of_the_demonstration() -> None:
    assert artefacts.NAMES[:3] == SUPPLIED
    assert "ball_bar" not in artefacts.NAMES
    assert [*artefacts.artefact_types()][:4] == [*SUPPLIED, "ball_bar"]


def test_an_artefact_is_added_by_one_file(added: Path, tmp_path: Path) -> None:
    before = {*artefacts.artefact_types()}
    (added / "added_cube.py").write_text(CUBE)
    names = [*artefacts.artefact_types()]
    assert {*names} - before == {"added_cube"}
    assert names[:3] == [*SUPPLIED]
    assert artefacts.usual_sizes("added_cube") == {"side": 20.0}
    assert artefacts.make("added_cube", {"side": 10.0}).volume == pytest.approx(1000.0)
    with pytest.raises(ConfigError, match=r"Cube\.side: .* must be lengths above 0 mm"):
        artefacts.make("added_cube", {"side": -1.0})
    with pytest.raises(ConfigError, match=f"there are {', '.join(names)}"):
        artefacts.make("no_such_part")
    assert "added_cube" in importlib.reload(catalogue).NAMES
    words = ["artefact", "added_cube", "--out", str(tmp_path / "cube.stl"), "--json"]
    assert json.loads(CliRunner().invoke(app, words).stdout)["size_mm"] == [20.0, 20.0, 20.0]


def test_a_file_without_one_artefact_is_refused(added: Path) -> None:
    (added / "two.py").write_text("")
    with pytest.raises(TypeError, match=r"shapes\.two must define exactly one subclass of Artefact, not 0"):
        artefacts.artefact_types()


def test_names_do_not_need_trimesh() -> None:
    code = "import sys; import fpplab.artefacts as a; assert a.NAMES; sys.exit('trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_steps_rise_along_x() -> None:
    mesh = artefacts.make("steps")
    up = mesh.face_normals[:, 2] > 0.5
    treads = mesh.triangles_center[up]
    order = np.argsort(treads[:, 0])
    assert (np.diff(treads[order, 2]) >= 0.0).all()
    assert sorted(set(np.round(treads[:, 2], 6))) == [5, 10, 15, 20, 25]


def test_stl_is_read_back_as_the_same_body(tmp_path: Path) -> None:
    mesh = artefacts.make("pillars")
    artefacts.save_stl(mesh, tmp_path / "pillars.stl")
    read = load_mesh(tmp_path / "pillars.stl")
    assert read.is_watertight
    assert read.volume == pytest.approx(mesh.volume, rel=1e-6)


def test_unknown_artefact_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=f"there are {', '.join(artefacts.artefact_types())}"):
        artefacts.make("no_such_part")


def test_artefacts_of_other_sizes() -> None:
    low, high = artefacts.make(
        "steps", {"footprint": (60.0, 40.0), "heights": (1.0, 2.0, 3.0, 4.0, 6.0)}
    ).bounds
    np.testing.assert_allclose([low, high], [[-30, -20, 0], [30, 20, 6]])
    assert artefacts.make("pyramid", {"height": 30.0}).bounds[1, 2] == 30.0
    with pytest.raises(ConfigError, match="'steps' has no length 'hight'; it has footprint, heights"):
        artefacts.make("steps", {"hight": 3.0})
    with pytest.raises(
        ConfigError, match=r"'pyramid' needs for 'foot' as many lengths as in \(80.0, 60.0\), not 5"
    ):
        artefacts.make("pyramid", {"foot": 5.0})
    with pytest.raises(ConfigError, match="must be lengths above 0 mm"):
        artefacts.make("pyramid", {"height": -1.0})


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (lambda: Pyramid(top=(90.0, 6.0)), "top"),
        (lambda: Pyramid(thickness=30.0), "thickness"),
        (lambda: Pyramid(height=float("nan")), "height"),
        (lambda: Pillars(diameters=(30.0, 9.0, 9.0, 9.0)), "diameters"),
        (lambda: Pillars(heights=(4.0, 9.0)), "thickness"),
        (lambda: Staircase(heights=(5.0, 5.0)), "heights"),
        (lambda: Staircase(heights=()), "heights"),
        (lambda: Staircase(footprint=(-1.0, 2.0)), "footprint"),
    ],
)
def test_impossible_shapes_are_refused_by_field(build: object, field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        build()  # type: ignore[operator]


def test_the_command_writes_the_sliced_shape_and_counts_its_layers(tmp_path: Path) -> None:
    out = tmp_path / "printed.stl"
    words = ["artefact", "steps", "--out", str(out), "--layer", "0.2", "--bead", "0.03", "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["layers"] == 125
    assert result["size_mm"] == pytest.approx([90.0, 70.0, 25.0])
    assert len(load_mesh(out).faces) == result["faces"] > 1000


def test_the_command_writes_the_drawn_shape_without_layers(tmp_path: Path) -> None:
    words = ["artefact", "steps", "--out", str(tmp_path / "drawn.stl"), "--json"]
    result = json.loads(CliRunner().invoke(app, words).stdout)
    assert result.keys() == {"size_mm", "faces", "mesh"}
    assert result["faces"] == len(artefacts.make("steps").faces)


@pytest.mark.parametrize(
    ("options", "field"), [(["--bead", "0.03"], "--layer"), (["--layer", "0"], "layer_mm")]
)
def test_the_command_refuses_impossible_layers(tmp_path: Path, options: list[str], field: str) -> None:
    out = tmp_path / "printed.stl"
    done = CliRunner().invoke(app, ["artefact", "steps", "--out", str(out), *options])
    assert isinstance(done.exception, ConfigError)
    assert field in str(done.exception)
    assert not out.exists()
