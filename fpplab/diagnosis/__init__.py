"""What is wrong with a scan, by its own frames and points, and whether to believe the result."""

from fpplab.diagnosis.catalogue import cause_named, known_causes, load_limits
from fpplab.diagnosis.finding import FaultCause, Finding
from fpplab.diagnosis.limits import DiagnosisLimits
from fpplab.diagnosis.verdict import (
    Diagnosis,
    UselessScanError,
    Verdict,
    diagnose_decoded,
    diagnose_frames,
    diagnose_points,
    diagnose_poses,
    diagnose_scan,
    diagnosis_of,
)

__all__ = [
    "Diagnosis",
    "DiagnosisLimits",
    "FaultCause",
    "Finding",
    "UselessScanError",
    "Verdict",
    "cause_named",
    "diagnose_decoded",
    "diagnose_frames",
    "diagnose_points",
    "diagnose_poses",
    "diagnose_scan",
    "diagnosis_of",
    "known_causes",
    "load_limits",
]
