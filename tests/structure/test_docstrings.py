"""Every public class, function and method is described by numpydoc's rules; see docstrings.py."""

from __future__ import annotations

import pytest

from tests.structure.docstrings import ROOT, document_names, lacks, sources

FOLDERS = sorted({path.relative_to(ROOT).parent.as_posix() for path in sources()})


@pytest.fixture(scope="module")
def documents() -> set[str]:
    return document_names()


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_leave_nothing_out(folder: str, documents: set[str]) -> None:
    missing = [
        line
        for path in sources()
        if path.relative_to(ROOT).parent.as_posix() == folder
        for line in lacks(path, documents)
    ]
    assert not missing, f"\n{len(missing)} left out:\n" + "\n".join(missing)
