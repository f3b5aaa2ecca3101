"""The verdict on an acceptance test: each error is told by its cause, on shapes whose errors are known."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.clouds import Cloud, save_cloud
from fpplab.comparison.acceptance import Acceptance, BallBarTest, Standard, verify_ball_bar, verify_plane
from fpplab.core import config
from fpplab.diagnosis import Diagnosis, UselessScanError, Verdict
from fpplab.diagnosis.acceptance import diagnose_acceptance
from tests.comparison.acceptance.test_acceptance import (
    PITCH,
    SIGMA,
    run,
    spheres_over_a_wall,
    standard,
    tilted_plane,
)

ENOUGH = {"PF": 2, "PS": 2, "SD": 2, "F": 1}
LIMITS = {"PF": 100.0, "PS": 20.0, "SD": 20.0, "F": 100.0}


def with_pixels(cloud: Cloud) -> Cloud:
    """The same cloud with the pixels that its camera's rays have."""
    seen = cloud.points[:, :2] / cloud.points[:, 2:] / PITCH
    return replace(cloud, pixels=np.rint(seen).astype(np.int32) + 300, size=(601, 601))


def scaled(cloud: Cloud, by: float) -> Cloud:
    return replace(cloud, points=(by * cloud.points).astype(np.float32))


def judged(bars: list[float], planes: list[Cloud], known: Standard | None = None) -> Diagnosis:
    """The verdict on ball bars that are scaled by these factors, and on planes."""
    known = known or standard(positions=ENOUGH, mpe_um=LIMITS)
    of_planes = tuple(verify_plane(cloud, known, f"plane {k}") for k, cloud in enumerate(planes))
    return diagnose_acceptance(Acceptance(known, tuple(map(bar_test, bars)), of_planes))


@cache
def bar_test(scale: float) -> BallBarTest:
    return verify_ball_bar(scaled(bar(), scale), standard(), "bar")


@cache
def bar() -> Cloud:
    return spheres_over_a_wall(sigma=SIGMA)


@pytest.fixture(scope="module")
def plane() -> Cloud:
    return with_pixels(tilted_plane(SIGMA))


def causes(found: Diagnosis) -> list[str]:
    return [one.cause.key for one in found.findings]


def test_within_the_limits_in_enough_positions_is_good(plane: Cloud) -> None:
    found = judged([1.0, 1.0], [plane])
    assert found.verdict is Verdict.GOOD
    assert found.findings == ()
    assert "PF, PS, SD, F are within" in found.reason


def test_few_positions_are_doubtful(plane: Cloud) -> None:
    found = judged([1.0], [plane])
    assert found.verdict is Verdict.DOUBTFUL
    assert causes(found) == ["few_positions"]
    assert "SD in 1 of 2" in found.reason
    assert "PF in" not in found.reason


def test_without_limits_nothing_is_judged() -> None:
    found = judged([1.0, 1.0], [], standard(positions=ENOUGH, mpe_um={}))
    assert causes(found) == ["no_limits"]
    assert [one.split(":")[0] for one in found.unknown] == ["PF", "PS", "SD", "F"]


@pytest.mark.whole
@pytest.mark.parametrize(
    ("scale", "verdict"),
    [(1.001, Verdict.DOUBTFUL), (0.999, Verdict.DOUBTFUL), (1.003, Verdict.USELESS), (0.98, Verdict.USELESS)],
)
def test_a_scale_is_told_from_what_depends_on_the_place(plane: Cloud, scale: float, verdict: Verdict) -> None:
    found = judged([scale, scale + 1e-5], [plane])
    assert causes(found)[0] == "scale"
    said = re.search(r"lengths are wrong by (\S+) %", found.reason)
    assert said is not None
    assert float(said[1]) == pytest.approx(100 * (scale - 1), abs=0.002)
    assert "sphere_size" not in causes(found), "the scale explains it"
    assert found.verdict is verdict
    uneven = judged([1.0005, 0.9994], [plane])
    assert causes(uneven)[0] == "uneven_lengths"


def test_a_gross_scale_is_useless_without_a_limit_too() -> None:
    assert judged([1.02, 1.02], [], standard(positions=ENOUGH, mpe_um={})).verdict is Verdict.USELESS


@pytest.mark.parametrize(("sigma", "wave", "cause"), [(0.03, 0.0, "noise"), (0.005, 0.1, "form")])
def test_noise_is_told_from_a_bent_surface(sigma: float, wave: float, cause: str) -> None:
    found = judged([1.0, 1.0], [with_pixels(tilted_plane(sigma, wave))])
    assert causes(found) == [cause]
    assert "F is" in found.reason
    assert "neighbouring pixels share" in found.reason


def test_spheres_too_large_at_a_right_spacing() -> None:
    large = spheres_over_a_wall(radius=10.03)
    known = standard(positions=ENOUGH)
    found = diagnose_acceptance(Acceptance(known, 2 * (verify_ball_bar(large, known, "bar"),)))
    assert causes(found) == ["sphere_size"]
    assert "60.0 µm are left when the scale is taken out" in found.reason


@pytest.mark.whole
def test_the_command_ends_with_4_where_the_system_is_useless(tmp_path: Path) -> None:
    (tmp_path / "standard.yaml").write_text(config.dump(standard(positions=ENOUGH)))
    words: list[object] = ["--standard", tmp_path / "standard.yaml", "--spheres"]
    for k in range(2):
        save_cloud(scaled(bar(), 1.02), tmp_path / f"bar{k}.ply")
        words.append(tmp_path / f"bar{k}.ply")
    done = run(*words, "--out", tmp_path / "verify.html", "--json")
    assert isinstance(done.exception, UselessScanError)
    assert done.exception.exit_code == 4
    found: dict[str, Any] = dict(done.exception.details)
    assert found["verdict"] == "useless"
    assert found["findings"][0]["cause"] == "scale"
    assert "target file" in found["findings"][0]["remedy"]
    assert found["quantities"]["SD"]["passed"] is False
    page = (tmp_path / "verify.html").read_text()
    assert "Useless" in page
    assert "lengths are wrong by +2.0" in page


@pytest.mark.whole
def test_the_command_says_the_verdict_first(tmp_path: Path) -> None:
    (tmp_path / "standard.yaml").write_text(config.dump(standard(positions=ENOUGH)))
    save_cloud(bar(), tmp_path / "bar.ply")
    words = ["--standard", tmp_path / "standard.yaml", "--spheres", tmp_path / "bar.ply"]
    done = run(*words, "--out", tmp_path / "verify.html", "--json")
    assert done.exit_code == 0
    answer = json.loads(done.stdout)
    assert list(answer)[:4] == ["verdict", "reason", "findings", "unverified"]
    assert answer["verdict"] == "doubtful"
    first = next(line for line in done.stderr.splitlines() if not line.endswith("…"))
    assert first.startswith("verdict: doubtful: few_positions")
