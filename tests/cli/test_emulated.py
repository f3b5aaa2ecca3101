"""The real drivers on the emulated bench measure what the virtual bench by itself does."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core.config import find_config
from fpplab.sessions.session import Session
from tests.support.commands import Command, Demo


@pytest.mark.whole
def test_the_cloud_is_that_of_the_virtual_bench(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    """Stepped and triggered: the frames are the same to the last bit, the noise as well."""
    plan = find_config("plan_paper.yaml").read_text(encoding="utf-8").replace("steps: 12", "steps: 4")
    (tmp_path / "stepped.yaml").write_text(plan, encoding="utf-8")
    (tmp_path / "triggered.yaml").write_text(plan + "trigger: triggered\n", encoding="utf-8")
    calibration = demo.folder / "calibration.yaml"

    def scanned(rig: str, trigger: str) -> Session:
        out = tmp_path / f"{rig}-{trigger}"
        words = ("--rig", f"{rig}.yaml", "--plan", tmp_path / f"{trigger}.yaml", "--calibration", calibration)
        done = fpplab("scan", *words, "--out", out, "--json")
        assert done.code == 0, done.err
        assert done.json["points"] > 50_000
        return Session.open(out)

    simulated = scanned("rig_demo_quick", "stepped")
    for trigger in ("stepped", "triggered"):
        emulated = scanned("rig_emulated_quick", trigger)
        for ours, theirs in zip(emulated.stack(), simulated.stack(), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert (emulated.path / "cloud.ply").read_bytes() == (simulated.path / "cloud.ply").read_bytes()


@pytest.mark.nightly
def test_a_missed_trigger_leaves_no_cloud(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    rig = find_config("rig_emulated_quick.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        rig.replace("refresh_hz: 50}", "refresh_hz: 50, faults: {missed: [5], doubled: [20]}}"),
        encoding="utf-8",
    )
    plan = find_config("plan_paper.yaml").read_text(encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(plan + "trigger: triggered\n", encoding="utf-8")
    words = ("--plan", tmp_path / "plan.yaml", "--calibration", demo.folder / "calibration.yaml")
    done = fpplab("scan", "--rig", tmp_path / "rig.yaml", *words, "--out", tmp_path / "scan", "--json")
    assert done.code == 3, done.err
    assert not (tmp_path / "scan" / "cloud.ply").exists()
