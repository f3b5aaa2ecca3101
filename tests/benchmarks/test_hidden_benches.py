"""A long run over hidden benches goes on where it ended."""

from pathlib import Path

import pytest

from benchmarks import hidden_benches
from benchmarks.predict import ComparedFigure, JudgedBench

SEEDS = (9422, 9434)
"""One bench without a foreign effect and one with."""


@pytest.fixture
def judged_seeds(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds of the benches that are judged, each at no cost."""
    seeds: list[int] = []

    def judged(seed: int, folder: Path, kind: str | None = None) -> JudgedBench:
        seeds.append(seed)
        answer = ComparedFigure(10.0, 9.0, 12.0, 11.0)
        return JudgedBench(
            seed,
            kind,
            verdict="good",
            is_good=True,
            nearer=("images: 0.0 σ, poses 50.0 µm",),
            poses_um=(3.0, 4.0),
            placed_um=(5.0, 6.0),
            sigmas={"ink": 1.0, "camera.fx": -4.0},
            answers={"other_plan": {"distance_um": answer, "noise_um": answer}},
            processor_s=1.5,
        )

    monkeypatch.setattr(hidden_benches, "judged", judged)
    return seeds


def test_benches_whose_figures_are_kept_are_not_judged_again(judged_seeds: list[int], tmp_path: Path) -> None:
    first = hidden_benches.kept_or_judged(SEEDS[0], tmp_path)
    results = {one.name: one.value for one in hidden_benches.hidden_bench_figures(tmp_path, SEEDS)}
    assert judged_seeds == list(SEEDS)
    assert hidden_benches.kept_or_judged(SEEDS[0], tmp_path) == first
    assert first.answers["other_plan"]["noise_um"].off == pytest.approx(1 / 11)
    assert results["hidden_parameters_within_3_sigma"] == 0.5
    assert results["hidden_foreign_refused_steps_nearer"] == 1


def test_a_line_names_what_is_beyond(judged_seeds: list[int], tmp_path: Path) -> None:
    line = hidden_benches.bench_line(hidden_benches.kept_or_judged(SEEDS[1], tmp_path))
    assert line.startswith("9434 drift: good; poses 4 µm RMS, 4 at most, 6 in the camera's frame; 2 param")
    assert "1 beyond 3 σ (camera.fx -4.0 σ)" in line
    assert "other_plan distance_um -9 %" in line
    refused = JudgedBench(9434, "drift", refused="no board")
    assert hidden_benches.bench_line(refused) == "9434 drift: refused: no board"


def test_foreign_kinds_follow_the_benches_without() -> None:
    kinds = list(hidden_benches.BENCHES.values())
    assert kinds[:12] == [None] * 12
    assert len(set(kinds[12:])) == 5
    assert None not in kinds[12:]
