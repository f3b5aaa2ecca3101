"""Names of the files of a session."""

PLAN, RIG, ORIGIN = "plan.yaml", "rig.yaml", "origin.yaml"
"""What was projected; what with, as resolved; when, where and with which devices it was begun."""
FORMAT, LOG = "session.yaml", "log.jsonl"
"""In which version of the format it is; what was done with it, when and by which program."""
JOURNAL, FRAMES, CHECKSUMS = "journal.jsonl", "frames", "files.jsonl"
"""A line for each frame; the folder of their files; the checksums of the other files."""
DECODED, CLOUD, CALIBRATION = "decoded.npz", "cloud.ply", "calibration.yaml"
REPORT, VERDICT = "report.html", "verdict.yaml"
RECORDING = "view.rrd"  # what the viewer showed, in any folder of results
SESSION_FILES = frozenset(
    (PLAN, RIG, ORIGIN, FORMAT, LOG, JOURNAL, CHECKSUMS)
    + (DECODED, CLOUD, CALIBRATION, REPORT, VERDICT, RECORDING)
)
