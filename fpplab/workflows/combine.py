"""Combine several calibrations of one rig."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.files import refuse_existing
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.results.characterisation import CombinationResult


@dataclass(frozen=True)
class CombinationRequest:
    """Which calibrations to combine, and where the new one goes."""

    calibrations: tuple[Path, ...]
    out: Path
    force: bool = False  # whether an existing file is replaced


def run_combination(request: CombinationRequest, observer: Observer | None = None) -> CombinationResult:
    """Find the mean of several calibrations and what varies between them, and write the new one."""
    from fpplab.calibration.model import Calibration
    from fpplab.characterisation import combine
    from fpplab.results.characterisation import CombinationResult

    observer = observer or Observer()
    refuse_existing(request.out, request.force)
    calibrations = [Calibration.load(path) for path in request.calibrations]
    with observer.stage("Combining") as progress:
        combination = combine(calibrations, list(map(str, request.calibrations)))
        progress(1.0)
    combination.calibration.save(request.out)
    return CombinationResult(combination, request.calibrations, request.out)
