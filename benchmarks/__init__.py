"""Benchmarks: each figure beside its baseline, both measured in the same run.

    python -m benchmarks [NAME] [--json]

A benchmark is a module of this package whose function `run`, without arguments, returns `Result`s; its name
is the module's. They need a checkout: they are not installed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

from fpplab.core.errors import ConfigError


@dataclass(frozen=True)
class Result:
    """One figure beside its baseline, in the same unit.

    Attributes
    ----------
    name : str
        Of the figure.
    value : float
        What was measured.
    unit : str
        Of value and baseline.
    baseline : float
        What it is compared with.
    ratio : float
        How many times better than the baseline it is.
    """

    name: str
    value: float
    unit: str
    baseline: float
    ratio: float


def below(name: str, value: float, unit: str, limit: float) -> Result:
    """Put a figure beside what it must not exceed.

    Parameters
    ----------
    name : str
        Of the figure.
    value : float
        What was measured.
    unit : str
        Of both.
    limit : float
        What it must not exceed.

    Returns
    -------
    Result
        Its ratio is at least 1 where it does.
    """
    return Result(name, value, unit, limit, limit / max(value, 1e-9))


def above(name: str, value: float, unit: str, least: float) -> Result:
    """Put a figure beside what it must reach.

    Parameters
    ----------
    name : str
        Of the figure.
    value : float
        What was measured.
    unit : str
        Of both.
    least : float
        What it must reach.

    Returns
    -------
    Result
        Its ratio is at least 1 where it does.
    """
    return Result(name, value, unit, least, value / least)


SHARED = ("hidden", "limit_decoding", "limit_lattice", "limit_noise", "optimise_workers", "peak", "virtual")
"""Modules of this package that are no benchmarks of their own."""


LONG = ("crash", "optimise", "outside", "predict")
"""Benchmarks that take from twenty minutes to hours: they are run only if they are named."""


def benchmark_names() -> list[str]:
    """List the benchmarks: every other module of this package.

    Returns
    -------
    list of str
        Sorted.
    """
    return sorted(m.name for m in iter_modules(__path__) if m.name not in SHARED and m.name[0] != "_")


def benchmark(name: str) -> Callable[[], list[Result]]:
    """Find a benchmark by its name.

    Parameters
    ----------
    name : str
        One of `benchmark_names()`.

    Returns
    -------
    callable
        The module's `run`: without arguments, gives its results.

    Raises
    ------
    ConfigError
        There is none of that name.
    """
    if name not in benchmark_names():
        raise ConfigError(f"there is no benchmark '{name}'; there are {', '.join(benchmark_names())}")
    run: Callable[[], list[Result]] = import_module(f"{__name__}.{name}").run
    return run
