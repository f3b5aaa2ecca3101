"""A short soak, and that growth is noticed."""

from pathlib import Path

import pytest

from tests.soak.measure import Held, growth
from tests.soak.rounds import plug_cycles, scans


def held(count: int, handles: int = 0, threads: int = 0, memory_mb: float = 0.0) -> list[Held]:
    """Rounds with so much more of each every time."""
    return [Held(10 + k * handles, 4 + k * threads, 0, 300 + k * memory_mb) for k in range(count)]


@pytest.mark.parametrize(
    ("rounds", "complaint"),
    [
        (held(40, handles=1), "handles grow from 20 to 49"),
        (held(40, threads=1), "threads grow"),
        (held(40, memory_mb=1.0), "memory grows by 1.000 MB a round"),
    ],
)
def test_growth_is_noticed(rounds: list[Held], complaint: str) -> None:
    assert complaint in "".join(growth(rounds))


def test_what_stays_is_flat() -> None:
    assert growth(held(40)) == growth(held(12)) == []


@pytest.mark.nightly
def test_scans_and_reconnections_leave_nothing(tmp_path: Path) -> None:
    for rounds in (scans(tmp_path, 14), plug_cycles(tmp_path, 12)):
        found = [Held.now() for _ in rounds]
        assert growth(found) == []
