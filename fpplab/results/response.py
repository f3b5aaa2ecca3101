"""The result of `fpplab gamma`: a response, and whether it is good enough for a plan."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.core.conventions import Floats
from fpplab.devices import Frame
from fpplab.patterns.phase_error import ResponseJudgement
from fpplab.patterns.response import Response
from fpplab.results.provenance import Provenance


@dataclass(frozen=True, eq=False)
class GreyLevelFrame:
    """A uniform grey-level image as the camera saw it."""

    level: int  # shown, of 255
    frame: Frame


@dataclass(frozen=True, eq=False)
class ResponseResult:
    """A fitted response, judged for a plan."""

    response: Response
    levels: Floats  # (K, 2) shown and seen, as shares of full scale
    judgement: ResponseJudgement
    provenance: Provenance
    response_file: Path
    picture_file: Path
    report_file: Path

    def figures(self) -> dict[str, Any]:
        return {**self.response.summary(), "judgement": self.judgement.model_dump(mode="json")}

    def summary(self) -> dict[str, Any]:
        return {
            **self.figures(),
            "provenance": self.provenance.summary(),
            "response": str(self.response_file),
            "picture": str(self.picture_file),
            "report": str(self.report_file),
        }
