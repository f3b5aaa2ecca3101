"""A seeded fault: what goes wrong, where, and how it is written."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """A fragment of Python that stands once inside a definition of a file, and what it becomes.

    `within` is the qualified name of a function, class or constant (`Device.open`); empty: the whole module.
    tests/conformance/fragments.py says how `old` and `new` are written.
    """

    name: str
    file: str
    within: str
    old: str
    new: str
