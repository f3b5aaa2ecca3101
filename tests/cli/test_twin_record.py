"""Scans with chosen fringes on a simulated rig, from the command line."""

from pathlib import Path

import pytest

from fpplab.sessions.session import Session
from tests.cli.test_twin_input import bench
from tests.support.commands import Command


@pytest.mark.whole
def test_a_scan_with_chosen_fringes_replaces_another_only_when_told(fpplab: Command, tmp_path: Path) -> None:
    rig, out = bench(tmp_path / "rig"), tmp_path / "scan"
    call = ("twin", "record", "--rig", rig, "--stripes", 8, "--steps", 3, "--out", out)
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    first = fpplab(*call, "--json", env=cache)
    assert first.code == 0, first.err
    session = Session.open(out)
    assert session.missing() == []
    assert first.json["images"] == session.plan.images
    assert first.json["points"] > 500
    refused = fpplab(*call, env=cache)
    assert refused.code != 0
    assert "--force" in refused.err
    again = fpplab(*call, "--force", env=cache)
    assert again.code == 0, again.err
    assert f"points: {first.json['points']}\n" in again.out
