"""Lengths with a unit, and numbers of bytes."""

import pytest

from fpplab.core.errors import ConfigError
from fpplab.core.units import length_mm, readable_bytes


@pytest.mark.parametrize(
    ("words", "mm"),
    [
        ("20um", 0.02),
        ("20 µm", 0.02),
        ("20μm", 0.02),
        ("0.02mm", 0.02),
        ("2e-5 m", 0.02),
        ("500nm", 0.0005),
        (" 1cm ", 10.0),
        (".5um", 0.0005),
    ],
)
def test_a_length_is_read_with_its_unit(words: str, mm: float) -> None:
    assert length_mm(words, "--until") == pytest.approx(mm, rel=1e-12)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("20", "its unit is missing"),
        ("20px", "'px' is no unit of length"),
        ("um", "must be a length with its unit"),
        ("", "must be a length with its unit"),
        ("0um", "greater than 0"),
        ("-3um", "greater than 0"),
        ("1e999um", "greater than 0"),
        ("1e-um", "is no number"),
        ("2 0um", "must be a length with its unit"),
        ("nanum", "must be a length"),
        ("20UM", "'UM' is no unit"),
        ("20um 3", "must be a length"),
    ],
)
def test_what_is_no_length_is_refused(words: str, why: str) -> None:
    with pytest.raises(ConfigError, match=f"--until is '{words}': .*{why}"):
        length_mm(words, "--until")


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1000, "1.00 kB"),
        (12_345, "12.3 kB"),
        (999_499, "999 kB"),
        (999_500, "1.00 MB"),
        (1_230_000, "1.23 MB"),
        (45_600_000_000, "45.6 GB"),
        (7 * 10**12, "7.00 TB"),
        (1234 * 10**15, "1.23e+03 PB"),
    ],
)
def test_a_number_of_bytes_has_three_digits_and_a_unit(count: int, words: str) -> None:
    assert readable_bytes(count) == words
