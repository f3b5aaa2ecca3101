"""`fpplab gamma` on a small virtual bench, and a plan that uses what it found."""

from pathlib import Path

import pytest
import yaml

from fpplab.patterns.plan import Plan
from tests.sim.conftest import RIG, plain, write_world
from tests.support.commands import NO_DISPLAY, Command
from tests.support.recordings import Recording

PLAN = """
fringes: [{axis: x, stripes: 16, steps: 3}]
greys: {levels: 9, repeats: 2}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A rig whose projector has g = 2.2, and a plan of three steps."""
    world = plain()
    world["projector"]["response"] = {"a": 1.0, "b": 0.0, "g": 2.2}
    write_world(tmp_path, {**world, "mounted": "card"})
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "plan.yaml").write_text(PLAN)
    return tmp_path


@pytest.mark.whole
def test_the_response_is_found_judged_and_used(fpplab: Command, folder: Path) -> None:
    words = (
        "gamma",
        "--rig",
        folder / "rig.yaml",
        "--plan",
        folder / "plan.yaml",
        "--item",
        "card",
        "--json",
    )
    done = fpplab(*words, "--out", folder / "response.yaml", "--view", env=NO_DISPLAY)
    assert done.code == 0, done.err
    found = done.json
    assert found["g"] == pytest.approx(2.2, abs=max(1e-3, 4 * found["sigma"][2]))
    assert (len(found["levels"]), len(found["regions"]), len(found["covariance"])) == (9, 9, 3)
    assert not found["judgement"]["good_enough"]
    assert "pre-correct the patterns" in found["judgement"]["sentence"]
    shown = Recording(folder / "response.rrd")
    assert shown.frames("images/camera") == list(range(18))  # nine levels, twice
    assert shown.value("diagrams/response", "MediaType") == "image/png"
    assert Path(found["picture"]).read_bytes().startswith(b"\x89PNG")

    (folder / "plan.yaml").write_text(PLAN + "response: response.yaml\n")
    plan = Plan.load(folder / "plan.yaml")
    assert plan.response is not None
    assert plan.response.g == found["g"]
    more = fpplab(*words, "--out", folder / "second.yaml", "--levels", 6, "--repeats", 1)
    assert more.code == 0, more.err
    assert len(more.json["levels"]) == 6
    assert more.json["judgement"]["good_enough"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "plan.yaml"), "exists already"),
        (("--out", "r.png"), "is the name of the picture"),
        (("--out", "r.yaml", "--levels", "4"), "--levels is '4': must be greater than or equal to 5"),
        (("--out", "r.yaml", "--repeats", "0"), "--repeats is '0': must be greater than or equal to 1"),
        (("--out", "r.yaml", "--plan", "bent.yaml"), "'response' must name a file written by `fpplab gamma`"),
    ],
)
def test_wrong_input_is_one_sentence(
    fpplab: Command, folder: Path, options: tuple[str, ...], words: str
) -> None:
    (folder / "bent.yaml").write_text(PLAN + "response: plan.yaml\n")
    named = [folder / o if o.endswith((".yaml", ".png")) else o for o in options]
    done = fpplab("gamma", "--rig", folder / "rig.yaml", *named, "--json")
    assert done.code == 2
    assert words in done.json["error"]
    assert yaml.safe_load((folder / "plan.yaml").read_text())["greys"] == {"levels": 9, "repeats": 2}
