"""What is wrong with a scan, by its own frames and points, and whether to believe the result."""

from fpplab.diagnosis.catalogue import REMEDIES, FaultCause, Finding
from fpplab.diagnosis.verdict import (
    Diagnosis,
    UselessScanError,
    Verdict,
    diagnose_frames,
    diagnose_poses,
    diagnose_scan,
    diagnosis_of,
)

__all__ = [
    "REMEDIES",
    "Diagnosis",
    "FaultCause",
    "Finding",
    "UselessScanError",
    "Verdict",
    "diagnose_frames",
    "diagnose_poses",
    "diagnose_scan",
    "diagnosis_of",
]
