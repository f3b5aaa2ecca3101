"""The results of decoding a session to maps, and of triangulating maps without a session."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.clouds import Cloud
from fpplab.diagnosis import Diagnosis
from fpplab.diagnosis.islands import island_counts
from fpplab.phase import Decoded


@dataclass(frozen=True, eq=False)
class DecodingResult:
    """Maps of projector coordinates, their verdict, and how long they took."""

    name: str  # of the session, in messages
    decoded: Decoded
    diagnosis: Diagnosis
    seconds: float
    out: Path  # where the maps go
    as_recorded: bool = False  # whether they were asked for whatever the verdict is

    @property
    def is_written(self) -> bool:
        """Whether the maps are left: useless ones only where they were asked for as recorded."""
        return bool(self.decoded.valid.any()) and (self.as_recorded or not self.diagnosis.is_useless)

    def require_usable(self) -> None:
        if not self.is_written:
            self.diagnosis.require_usable(self.name, self._figures())

    def summary(self) -> dict[str, Any]:
        return {**self.diagnosis.summary(), **self._figures()}

    def _figures(self) -> dict[str, Any]:
        islands = island_counts(self.decoded)
        figures: dict[str, Any] = {"valid": int(self.decoded.valid.sum()), "seconds": self.seconds}
        if self.decoded.height_mm is not None:
            figures["heights"] = int(np.isfinite(self.decoded.height_mm).sum())
        return figures if islands is None else {**figures, "islands": islands}


@dataclass(frozen=True, eq=False)
class MapsResult:
    """Points of maps that another program decoded."""

    decoded: Decoded
    cloud: Cloud
    diagnosis: Diagnosis
    seconds: float
    cloud_file: Path

    def summary(self) -> dict[str, Any]:
        epipolar = self.cloud.epipolar_px
        return {
            **self.diagnosis.summary(),
            "points": len(self.cloud),
            "pixels": int(self.decoded.valid.sum()),
            "epipolar_px": None if epipolar is None else float(np.median(np.abs(epipolar))),
            "seconds": self.seconds,
            "cloud": str(self.cloud_file),
        }
