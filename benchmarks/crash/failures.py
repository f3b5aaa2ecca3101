"""What went wrong: counted by kind, and described on stderr at once, since a whole run takes hours."""

from __future__ import annotations

import sys

Failures = dict[str, list[str]]
"""Descriptions by kind."""


def no_failures(*kinds: str) -> Failures:
    """Begin to count.

    Parameters
    ----------
    *kinds : str
        What may go wrong.

    Returns
    -------
    dict of str to list of str
        Nothing of any kind.
    """
    return {kind: [] for kind in kinds}


def note_failure(found: Failures, kind: str, words: str) -> None:
    """Count and describe one failure.

    Parameters
    ----------
    found : dict of str to list of str
        Is added to.
    kind : str
        One of its kinds.
    words : str
        What happened, and when.
    """
    found[kind].append(words)
    sys.stderr.write(f"{kind}: {words}\n")
    sys.stderr.flush()
