"""The journal of a search: a killed one is run again, asks for the same, and finds its results here."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.journals import append_line, cut_torn_line, make_journal, whole_lines
from fpplab.core.strict_json import parse_object
from fpplab.core.version import __version__
from fpplab.optimisation.candidate import Candidate, Score, candidate_fields
from fpplab.optimisation.problem import SearchProblem

IDENTITY_FIELDS = ("artefacts", "start", "calibrations")
"""Fields of a study on which its measurements depend; they identify the journal."""

ScoresOrReason = tuple[Score, ...] | str  # scores of the artefacts, or why the measurement failed

_candidate, _scores = TypeAdapter(Candidate), TypeAdapter(tuple[Score, ...])


class Journal:
    """The measurements of one study on one rig."""

    def __init__(self, path: Path, problem: SearchProblem, rig: dict[str, Any]) -> None:
        self.path = path
        plain = problem.model_dump(mode="json")
        self._header: dict[str, Any] = {"rig": rig, **{name: plain[name] for name in IDENTITY_FIELDS}}
        self._outcomes: dict[tuple[Candidate, int], ScoresOrReason] = {}
        if path.is_file():
            self._read()

    def __len__(self) -> int:
        return len(self._outcomes)

    def get(self, candidate: Candidate, seed: int) -> ScoresOrReason | None:
        return self._outcomes.get((candidate, seed))

    def add(self, candidate: Candidate, seed: int, outcome: ScoresOrReason) -> None:
        """Store a measurement, on disk before this returns."""
        if not (self.path.is_file() and self.path.stat().st_size):
            make_journal(self.path)
            append_line(self.path, json.dumps({**self._header, "fpplab": __version__}))
        fields: dict[str, Any] = (
            {"failed": outcome} if isinstance(outcome, str) else {"scores": [asdict(s) for s in outcome]}
        )
        append_line(self.path, json.dumps({"candidate": candidate_fields(candidate), "seed": seed, **fields}))
        self._outcomes[candidate, seed] = outcome

    def _read(self) -> None:
        cut_torn_line(self.path)  # a measurement whose recording was interrupted
        for number, line in enumerate(whole_lines(self.path), 1):
            try:
                data = parse_object(line)
                if number == 1:
                    self._check_header(data)
                else:
                    failed = "failed" in data
                    outcome = str(data["failed"]) if failed else _scores.validate_python(data["scores"])
                    candidate = _candidate.validate_json(json.dumps(data["candidate"]))
                    self._outcomes[candidate, data["seed"]] = outcome
            except (ValidationError, ValueError, KeyError, TypeError) as error:
                reason = config.describe(error) if isinstance(error, ValidationError) else str(error)
                raise DataError(f"{self.path} line {number}: is not a measurement ({reason})") from error

    def _check_header(self, header: dict[str, Any]) -> None:
        for name, expected in self._header.items():
            if header.get(name) != expected:
                raise ConfigError(
                    f"{self.path}: holds the measurements of a study whose '{name}' is another; name another "
                    "output, or add --force to start again"
                )
