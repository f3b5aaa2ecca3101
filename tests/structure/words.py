"""Words that are not to come back, each with the better one: the project's only list of them.

A pattern is a regular expression, matched line by line. Names are matched also as parts of other names
(`_rungs`, `SEAM_PX`), words of ordinary English only in the use that was wrong.
"""

from __future__ import annotations


def name(stem: str) -> str:
    """A pattern for a name or a part of one between underscores, singular or plural."""
    return rf"(?<![A-Za-z]){stem}s?(?![a-z])"


def class_name(stem: str) -> str:
    """A pattern for a class whose name is an ordinary word too: definition, calls, imports, annotations."""
    annotation = rf"(?:: |-> |\| |\[){stem}(?=\s*(?:[\],)=:|]|$))"
    return rf"\bclass {stem}\b|\b{stem}[(.\[]|\bimport\b.*\b{stem}\b|{annotation}"


WORDS = (
    (r"\bclimb\(", "unwrap"),
    (r"\bClimb", "unwrap"),
    (name("doubted"), "second_best_order"),
    (name("[Ll]adder"), "sequence of synthetic wavelengths"),
    (name("[Rr]ung"), "synthetic wavelength"),
    (r"(?<![A-Za-z])(?:SEAM|[Ss]eam)(?![a-z])", "edge margin"),  # a texture may have seams
    (class_name("Lab"), "CandidateRunner"),
    (class_name("What"), "Goal"),
    (class_name("Kept"), "a noun that says what is stored"),
    (r"\bSpent\b", "a noun that says which cost, such as TimeSpent"),
    (r"\bshaken\b", "with_vibration"),
    (r"(?i)trembl", "vibrate, vibrating"),
    (r"\bunseen\(", "a verb that says what is done"),
    (r"hasattr\(rig", "isinstance with a Protocol of fpplab.simulation"),
    (r"(?i)uniform greys", "uniform grey-level images"),
    (r"(?i)nobody looks", "what happens instead"),
    (r"(?i)by whose hand", "who has to act"),
    (r"(?i)so manieth", "sampling stride"),
    (r"(?i)none of both", "neither of the two"),
    (r"(?i)for who overlooks", "ignoring features below detail_mm"),
    (r"(?i)who brings more waits", "a full queue blocks the caller"),
    (r"(?i)what to see to before", "advice to the operator"),
    (r"(?i)picture's end is none", "the image border is not an edge"),
    (r"(?i)at the far end of its wire", "a device emulator"),
    (r"(?i)a person holds anything", "any item can be held by hand"),
    (r"\bfpplab bench\b", "python -m benchmarks"),
)
"""Pairs of a pattern and what to write instead."""
