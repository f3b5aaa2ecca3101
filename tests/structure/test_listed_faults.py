"""Every listed fault finds its place in today's sources, so a change of code adapts the fault too."""

from tests.mutants.listed import canonical, listed
from tests.support.commands import ROOT


def test_every_fault_finds_its_place_and_changes_it() -> None:
    complaints = []
    for fault in listed(ROOT):
        source = (ROOT / fault.file).read_bytes()
        try:
            if canonical(fault.seeded(source)) == canonical(source):
                complaints.append(f"'{fault.name}' changes nothing")
        except (LookupError, SyntaxError) as error:
            complaints.append(str(error))
    assert complaints == []


def test_names_of_faults_are_unique() -> None:
    names = [fault.name for fault in listed(ROOT)]
    assert sorted(set(names)) == sorted(names)
