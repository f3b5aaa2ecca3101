"""Memory that is used again: never while somebody holds it, and large files written past the cache."""

import gc
from pathlib import Path

import numpy as np
import pytest

from fpplab.core import buffers, files
from fpplab.core.files import write_large

COUNT = buffers.LIMITS.min_bytes // 4 + 5


@pytest.fixture(autouse=True)
def clean() -> None:
    gc.collect()
    buffers._returned.clear()
    buffers._free.clear()


def test_memory_is_used_again_once_the_last_view_is_gone() -> None:
    array = buffers.empty((5, COUNT), np.float32)
    place, view = array.ctypes.data, array[2:, ::2].T
    del array
    other = buffers.empty((5, COUNT), np.float32)
    assert not np.shares_memory(view, other)
    del view
    assert buffers.empty(5 * COUNT - 3, np.int32).ctypes.data == place


@pytest.mark.whole
def test_what_is_far_too_large_is_not_taken() -> None:
    place = buffers.empty(10 * COUNT).ctypes.data
    assert buffers.empty(COUNT).ctypes.data != place
    assert buffers.empty(9 * COUNT).ctypes.data == place


def test_no_more_is_kept_than_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(buffers, "LIMITS", buffers.BufferLimits(max_kept_bytes=3 * 4 * COUNT))
    many = [buffers.empty(COUNT) for _ in range(6)]
    del many
    held = buffers.empty(COUNT)
    assert sum(block.nbytes for block in (*buffers._free, *buffers._returned)) <= 3 * held.nbytes


@pytest.mark.whole
@pytest.mark.parametrize(
    "size", [0, 1, files.STAGED_BYTES, files.STAGED_BYTES + 4097, 3 * files.STAGED_BYTES - 1]
)
def test_a_large_file_holds_what_was_written(tmp_path: Path, size: int) -> None:
    content = np.random.default_rng(size).integers(0, 256, size, np.uint8).tobytes()
    parts = [content[:7], content[7:5000], content[5000:]]
    write_large(tmp_path / "x", lambda stream: [stream.write(part) for part in parts])
    assert (tmp_path / "x").read_bytes() == content


def test_a_large_file_is_written_where_a_process_was_killed(tmp_path: Path) -> None:
    (tmp_path / ".x.ab12_xyz").write_bytes(b"half of it")
    write_large(tmp_path / "x", lambda stream: stream.write(b"whole"))
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("x", b"whole")]


def test_what_is_not_approved_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"before")

    def refuse() -> None:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        write_large(tmp_path / "x", lambda stream: stream.write(b"after"), refuse)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("x", b"before")]
