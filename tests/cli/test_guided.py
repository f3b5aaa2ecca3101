"""`fpplab characterise --guide` as a whole command, and what goes with what."""

from pathlib import Path

import pytest

from fpplab.cli.commands.characterise import wanted_mm
from fpplab.core.errors import ConfigError
from tests.support.commands import NO_DISPLAY, Command
from tests.support.recordings import Recording


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ((False, "20um", None, "r", None), "--until goes with --guide"),
        ((False, None, (400.0, 500.0), "r", None), "--depth goes with --guide"),
        ((True, "20um", None, None, None), "--guide takes poses one at a time, and needs --rig"),
        ((True, "20", None, "r", None), "--until is '20': its unit is missing"),
        (
            (True, None, (500.0, 400.0), "r", None),
            "--depth is 500 400: must be two rising positive distances",
        ),
        ((True, None, None, "r", Path("limits.yaml")), "--limits is for recorded poses"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    given: tuple[bool, str | None, tuple[float, float] | None, str | None, Path | None], why: str
) -> None:
    with pytest.raises(ConfigError, match=why):
        wanted_mm(*given)


def test_the_uncertainty_is_told_in_mm() -> None:
    assert wanted_mm(True, "20um", None, "r", None) == pytest.approx(0.02)
    assert wanted_mm(False, None, None, None, None) is None


@pytest.mark.whole
def test_a_simulated_rig_is_characterised_by_poses_that_are_asked_for(
    fpplab: Command, tmp_path: Path
) -> None:
    out = tmp_path / "c.yaml"
    done = fpplab(
        "characterise", "--rig", "rig_demo_quick", "--target", "target_paper", "--guide", "--until", "50um",
        "--poses", 9, "--out", out, "--view", "--json", env=NO_DISPLAY,
    )  # fmt: skip
    assert done.code == 0, done.err
    guided = done.json["guided"]
    shown = Recording(out.with_suffix(".rrd"))
    assert shown.frames("world/camera/image")
    assert len(shown.value("world/boards", "Position3D")) > 100
    assert guided["reached"]
    assert guided["form_um"] <= guided["until_um"] == pytest.approx(50.0)
    assert 5 <= done.json["poses"] < 9
    assert done.json["poses"] == sum(one["accepted"] for one in guided["attempts"])
    assert "pose 4: in the" in done.err
    assert "-> 50 µm" in done.err
    assert not [w for w in done.json["warnings"] if "no point of a board" in w]
    page = out.with_suffix(".html").read_text()
    assert "Sequence of poses" in page
    assert guided["attempts"][3]["asked"] in page
    assert (tmp_path / "c_poses" / "next_pose.png").is_file()
    again = fpplab(
        "characterise", "--rig", "rig_demo_quick", "--target", "target_paper", "--guide", "--poses",
        done.json["poses"], "--out", out, "--json",
    )  # fmt: skip
    assert again.code == 0, again.err
    assert {one["asked"] for one in again.json["guided"]["attempts"]} == {"kept from before"}
    assert again.json["guided"]["form_um"] == pytest.approx(guided["form_um"], rel=0.02)
