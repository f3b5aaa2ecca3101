"""All causes: the modules of `fpplab.diagnosis.causes`, found by listing that package.

A module defines one cause, or the causes that one stage of work reports. Adding a module adds its causes to
verdicts, documentation and reports: nothing else has to name them.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import MappingProxyType

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.diagnosis import causes
from fpplab.diagnosis.finding import FaultCause
from fpplab.diagnosis.limits import DiagnosisLimits, LimitsSection


@cache
def known_causes() -> MappingProxyType[str, FaultCause]:
    """List all causes by their keys."""
    by_key: dict[str, FaultCause] = {}
    for entry in iter_modules(causes.__path__):
        module = import_module(f"{causes.__name__}.{entry.name}")
        # A module that reports another's cause imports it: the same object.
        for candidate in vars(module).values():
            if (
                isinstance(candidate, FaultCause)
                and by_key.setdefault(candidate.key, candidate) is not candidate
            ):
                raise TypeError(f"two causes have the key '{candidate.key}'; one is of {module.__name__}")
    return MappingProxyType(dict(sorted(by_key.items())))


def cause_named(key: str) -> FaultCause:
    """Look up a cause by its key."""
    if key not in known_causes():
        raise ConfigError(f"there is no cause '{key}'; there are {', '.join(known_causes())}")
    return known_causes()[key]


def limit_sections() -> dict[str, type[LimitsSection]]:
    known_causes()
    return {
        limits.section: limits
        for limits in sorted(LimitsSection.__subclasses__(), key=lambda limits: limits.section)
    }


def load_limits(path: Path) -> DiagnosisLimits:
    """Read a file of limits: sections of limits by their names, each one that is left out as usual."""
    with naming_other_kinds(path, "limits"):
        stated, sections = config.parse_yaml(config.read_text(path), path), limit_sections()
        if not isinstance(stated, dict):
            raise ConfigError(f"{path}: must have sections of limits, of {', '.join(sections)}")
        unknown = [name for name in stated if name not in sections]
        if unknown:
            raise ConfigError(f"{path}: there is no section '{unknown[0]}'; there are {', '.join(sections)}")
        changed = [config.validate(of, sections[name], f"{path}: {name}") for name, of in stated.items()]
        return DiagnosisLimits(tuple(changed))
