"""Hidden benches judged one by one: their figures are kept, so that a long run can be made in pieces.

    python -m benchmarks hidden_benches                      # all benches, some hours on two cores
    python -m benchmarks.hidden_benches FOLDER               # those whose figures are not in the folder
    python -m benchmarks.hidden_benches FOLDER 9422 9434     # of these seeds alone

What is recorded of a bench, matched, predicted and judged is that of `benchmarks.predict`. A bench that was
looked at while a method was changed judges no longer: take the seeds that follow.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

import numpy as np
from pydantic import TypeAdapter

from benchmarks import Result
from benchmarks.predict import FULL, SIGMAS, JudgedBench, figures, judged
from fpplab.cli import console
from fpplab.core.files import write_text

BENCHES: dict[int, str | None] = {
    **dict.fromkeys(FULL.seeds),
    **dict(enumerate(FULL.kinds, FULL.seeds[-1] + 1)),
}
"""Kind of foreign effect, or none, by seed."""


def run() -> list[Result]:
    """Judge all hidden benches; the baselines are the targets."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return hidden_bench_figures(Path(folder), tuple(BENCHES))


def hidden_bench_figures(folder: Path, seeds: Sequence[int]) -> list[Result]:
    """Judge benches, and sum up those that have a foreign effect apart from the others."""
    benches = [kept_or_judged(seed, folder) for seed in seeds]
    own, foreign = ([one for one in benches if (one.kind is None) == plain] for plain in (True, False))
    results = figures(own, "hidden") if own else []
    return results + (figures(foreign, "hidden_foreign") if foreign else [])


def kept_or_judged(seed: int, folder: Path) -> JudgedBench:
    """Give a bench's figures from the folder; a bench that has none there is judged, and they are kept."""
    path = folder / f"bench_{seed}.json"
    if not path.is_file():
        with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as recordings:
            bench = judged(seed, Path(recordings), kind=BENCHES[seed])
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(asdict(bench), indent=1))
        peak = getrusage(RUSAGE_SELF).ru_maxrss / 2**20
        console.log_status(f"{seed}: {peak:.2f} GiB at most, so far")
    bench = TypeAdapter(JudgedBench).validate_json(path.read_bytes())
    console.log_status(bench_line(bench))
    return bench


def bench_line(bench: JudgedBench) -> str:
    """Say what was found of a bench in a line."""
    name = f"{bench.seed} {bench.kind or 'plain'}"
    if bench.refused is not None:
        return f"{name}: refused: {bench.refused}"
    beyond = [f"{of} {off:+.1f} σ" for of, off in bench.sigmas.items() if abs(off) > SIGMAS]
    off = [
        f"{question} {figure} {100 * (answer.value / answer.measured - 1):+.0f} %"
        for question, answers in bench.answers.items()
        for figure, answer in answers.items()
    ]
    return (
        f"{name}: {bench.verdict}; poses {bench.poses_rms_um:.0f} µm RMS, {max(bench.poses_um):.0f} at most, "
        f"{np.max(bench.placed_um):.0f} in the camera's frame; {len(bench.sigmas)} parameters, "
        f"{len(beyond)} beyond {SIGMAS:g} σ ({', '.join(beyond)}); {', '.join(off)}; "
        f"nearer but refused: {', '.join(bench.nearer) or 'none'}; "
        f"{bench.processor_s:.0f} s of processor time"
    )


if __name__ == "__main__":
    wanted = [int(seed) for seed in sys.argv[2:]] or list(BENCHES)
    for one in hidden_bench_figures(Path(sys.argv[1]), wanted):
        console.log_status(f"{one.name}: {one.value:g} {one.unit} ({one.baseline:g})")
