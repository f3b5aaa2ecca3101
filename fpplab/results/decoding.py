"""The result of `fpplab decode`: projector coordinates of a session."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fpplab.phase import Decoded


@dataclass(frozen=True, eq=False)
class DecodingResult:
    """Maps of projector coordinates, and how long they took."""

    decoded: Decoded
    seconds: float

    def summary(self) -> dict[str, Any]:
        """Collect what `fpplab decode --json` prints."""
        return {"valid": int(self.decoded.valid.sum()), "seconds": self.seconds}
