"""Benchmarks: each figure beside its baseline, both measured in the same run.

    python -m benchmarks [NAME] [--json]

A benchmark is a module of this package whose function `run`, without arguments, returns `Result`s; its name
is the module's. They need a checkout: they are not installed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

from fpplab.core.errors import ConfigError


@dataclass(frozen=True)
class Result:
    """One figure beside its baseline, in the same unit."""

    name: str  # of the figure
    value: float  # what was measured
    unit: str  # of value and baseline
    baseline: float  # what it is compared with
    ratio: float  # how many times better than the baseline it is


def below(name: str, value: float, unit: str, limit: float) -> Result:
    """Put a figure beside what it must not exceed."""
    return Result(name, value, unit, limit, max(limit, 1e-9) / max(value, 1e-9))


def above(name: str, value: float, unit: str, least: float) -> Result:
    """Put a figure beside what it must reach."""
    return Result(name, value, unit, least, value / least)


SHARED = (
    "hidden",
    "limit_decoding",
    "limit_lattice",
    "limit_noise",
    "machine",
    "optimise_workers",
    "peak",
    "predict",
    "virtual",
)
"""Modules of this package that are no benchmarks of their own."""


SPEEDS = (
    "acquire",
    "characterise",
    "characterise_pose",
    "codes",
    "compare",
    "decode",
    "last_frame_to_cloud",
    "match",
    "optimise",
    "projector",
    "service",
    "triangulate",
    "twin",
    "viewer",
)
"""Benchmarks of speed, beside which what memory and disk of the machine allow is measured."""


LONG = (
    "correction",
    "crash",
    "explanations",
    "hidden_benches",
    "image_faults",
    "lengths",
    "optimise",
    "outside",
    "predict_plans",
    "real_captures",
    "service_endurance",
    "stale",
)
"""Benchmarks that take from twenty minutes to hours: they are run only if they are named."""


def benchmark_names() -> list[str]:
    """List the benchmarks: every other module of this package."""
    return sorted(m.name for m in iter_modules(__path__) if m.name not in SHARED and m.name[0] != "_")


def benchmark(name: str) -> Callable[[], list[Result]]:
    """Find a benchmark by its name."""
    if name not in benchmark_names():
        raise ConfigError(f"there is no benchmark '{name}'; there are {', '.join(benchmark_names())}")
    run: Callable[[], list[Result]] = import_module(f"{__name__}.{name}").run
    return run
