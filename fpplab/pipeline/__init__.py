"""The steps of a measurement, each from open devices or recorded sessions to a value."""

from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED, REPORT
from fpplab.pipeline.characterising import (
    characterise_sessions,
    correct_by_sessions,
    judge_sessions,
    observe_session,
    require_plan_fits,
)
from fpplab.pipeline.checking import doubts_about_session
from fpplab.pipeline.decoding import decode_session, parse_known, recording_and_fault
from fpplab.pipeline.depth import check_plan, plan_with_depth
from fpplab.pipeline.heights import decode_over_plane
from fpplab.pipeline.marks import locate_session_marks
from fpplab.pipeline.measuring import Reconstruction, finish_scan, reconstruct_points, reconstruct_session
from fpplab.pipeline.response import measure_response
from fpplab.pipeline.taking import check_disk_space, plan_stage_moves, take_or_resume_session, take_poses

__all__ = [
    "CALIBRATION",
    "CLOUD",
    "DECODED",
    "REPORT",
    "Reconstruction",
    "characterise_sessions",
    "check_disk_space",
    "check_plan",
    "correct_by_sessions",
    "decode_over_plane",
    "decode_session",
    "doubts_about_session",
    "finish_scan",
    "judge_sessions",
    "locate_session_marks",
    "measure_response",
    "observe_session",
    "parse_known",
    "plan_stage_moves",
    "plan_with_depth",
    "reconstruct_points",
    "reconstruct_session",
    "recording_and_fault",
    "require_plan_fits",
    "take_or_resume_session",
    "take_poses",
]
