"""NPZ files are believed only where they have room for what they declare."""

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core.archives import load_arrays


def npy(head: str, values: bytes) -> bytes:
    """An NPY file with a head of one's own."""
    text = head.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + values


def archive(path: Path, member: bytes, **how: Any) -> Path:
    with zipfile.ZipFile(path, "w", **how) as file:
        file.writestr("a.npy", member)
    return path


def test_arrays_are_read_as_they_were_saved(tmp_path: Path) -> None:
    written = {
        "a": np.arange(6, dtype="<f4").reshape(2, 3),
        "columns": np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)),
        "truths": np.array([True, False]),
        "one": np.float64(3.5),
        "none": np.empty((0, 3), np.float32),
    }
    np.savez_compressed(tmp_path / "a.npz", **written)
    read = load_arrays(tmp_path / "a.npz", [*written, "absent"])
    assert set(read) == set(written)
    for name, values in written.items():
        assert read[name].shape == np.shape(values)
        np.testing.assert_array_equal(read[name], values)


@pytest.mark.parametrize(
    ("head", "sentence"),
    [
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,), }", "takes 800000000000 bytes"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1), }", "takes 8 bytes, and 16 are there"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (-2, -1), }", "shape"),
        ("{'descr': '|O', 'fortran_order': False, 'shape': (2,), }", "not of numbers"),
        ("{'descr': '<U4', 'fortran_order': False, 'shape': (1,), }", "not of numbers"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': " + "(" * 500 + ")" * 500 + ", }", "."),
    ],
)
def test_heads_that_promise_what_is_not_there(tmp_path: Path, head: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        load_arrays(archive(tmp_path / "a.npz", npy(head, b"\0" * 16)), ["a"])


def test_versions_of_numpys_format_that_are_not_known(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="format"):
        load_arrays(archive(tmp_path / "a.npz", b"\x93NUMPY\x09\x00" + b"\0" * 100), ["a"])


def test_damage_of_any_kind_is_a_value_error(tmp_path: Path) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, a=np.arange(100))
    whole = content.getvalue()
    for cut in range(0, len(whole), 11):
        (tmp_path / "cut.npz").write_bytes(whole[:cut])
        with pytest.raises(ValueError, match=r"."):
            load_arrays(tmp_path / "cut.npz", ["a"])
    encrypted = bytearray(whole)
    for sign in (b"PK\x03\x04", b"PK\x01\x02"):
        place = whole.index(sign) + (6 if sign == b"PK\x03\x04" else 8)
        encrypted[place] |= 1
    (tmp_path / "secret.npz").write_bytes(encrypted)
    with pytest.raises(ValueError, match="encrypted"):
        load_arrays(tmp_path / "secret.npz", ["a"])


def test_other_faults_of_the_system_keep_their_kind(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_arrays(tmp_path / "none.npz", ["a"])
