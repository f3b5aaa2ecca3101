"""Benchmarks: each figure beside its baseline, both measured in the same run.

A benchmark is a function without arguments that returns `Result`s. `REGISTRY` maps
the names that `fpplab bench NAME` takes to "module:function", loaded when asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from fpplab.core.errors import ConfigError


@dataclass(frozen=True)
class Result:
    """One figure: `ratio` is how many times better than `baseline` it is, in the same `unit`."""

    name: str
    value: float
    unit: str
    baseline: float
    ratio: float


def below(name: str, value: float, unit: str, limit: float) -> Result:
    """A figure beside what it must not exceed."""
    return Result(name, value, unit, limit, limit / max(value, 1e-9))


def above(name: str, value: float, unit: str, least: float) -> Result:
    """A figure beside what it must reach."""
    return Result(name, value, unit, least, value / least)


REGISTRY = {
    "decode": "benchmarks.decode:run",
    "triangulate": "benchmarks.triangulate:run",
    "compare": "benchmarks.compare:run",
    "acquire": "benchmarks.acquire:run",
    "projector": "benchmarks.projector:run",
    "twin": "benchmarks.twin:run",
    "characterise": "benchmarks.characterise:run",
    "match": "benchmarks.match:run",
    "optimise": "benchmarks.optimise:run",
}


def benchmark(name: str) -> Callable[[], list[Result]]:
    """The benchmark of that name, or a `ConfigError` that lists them."""
    if name not in REGISTRY:
        raise ConfigError(f"there is no benchmark '{name}'; there are {', '.join(REGISTRY)}")
    module, function = REGISTRY[name].split(":")
    run: Callable[[], list[Result]] = getattr(importlib.import_module(module), function)
    return run
