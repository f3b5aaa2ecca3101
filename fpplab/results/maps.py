"""The result of triangulating maps without a session."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.clouds import Cloud
from fpplab.diagnosis import Diagnosis
from fpplab.phase import Decoded


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
