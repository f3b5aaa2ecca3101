"""Parsers of others run apart, and what ends, exhausts or detains them is refused in one sentence."""

import os
import struct
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fpplab.calibration.interchange import import_calibration
from fpplab.clouds import load_mesh
from fpplab.core import foreign
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.foreign import read_apart


def test_a_mesh_is_what_the_parser_reads(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(1)
    mesh.export(tmp_path / "ball.ply")
    parts = read_apart("ply", tmp_path / "ball.ply")
    np.testing.assert_allclose(parts["vertices"], mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(parts["faces"], mesh.faces)


def test_opencvs_entries_are_plain_arrays(tmp_path: Path) -> None:
    path = tmp_path / "some.yml"
    path.write_text("%YAML:1.0\n---\nA: 2.5\nB: word\nC: [ 1, 2 ]\nD: { e: 1 }\n")
    parts = read_apart("opencv", path)
    assert set(parts) == {"A", "B", "C"}
    assert (parts["A"].item(), parts["B"].item(), parts["C"].tolist()) == (2.5, "word", [1.0, 2.0])


def test_what_nests_without_end_ends_the_reader_alone(tmp_path: Path) -> None:
    path = tmp_path / "deep.yml"
    path.write_text("%YAML:1.0\n---\nA: " + "[" * 100_000)
    with pytest.raises(ValueError, match=r"its reader fails on it|OpenCV refuses it"):
        read_apart("opencv", path)


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        ("xml", '<?xml version="1.0"?><opencv_storage>' + "<a>" * 100_000 + "1" + "</a>" * 100_000),
        ("yaml", "%YAML:1.0\n---\nM1: " + "[" * 100_000 + "]" * 100_000 + "\n"),
        ("yaml", "%YAML:1.0\n---\nM1: " + "- " * 100_000 + "1\n"),
    ],
)
def test_nesting_that_ends_opencv_is_refused(suffix: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"deep.{suffix}"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"not readable as a file of OpenCV"):
        import_calibration([path])


@pytest.mark.whole
def test_a_reader_gets_no_more_memory_than_files_of_such_a_size_need(tmp_path: Path) -> None:
    path = tmp_path / "many.stl"
    path.write_bytes(b"\0" * 80 + struct.pack("<I", 0xFFFFFFFF) + b"\0" * 50)
    began = time.monotonic()
    with pytest.raises(DataError, match=r"holds no faces|is no readable STL mesh"):
        load_mesh(path)
    assert time.monotonic() - began < 20


def test_the_memory_of_a_reader_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    monkeypatch.setattr(foreign, "LIMITS", foreign.ReadingLimits(address_bytes=60_000_000))
    with pytest.raises(ValueError, match=r"fails|memory"):
        read_apart("stl", tmp_path / "ball.stl")


def test_a_reader_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    monkeypatch.setattr(foreign, "LIMITS", foreign.ReadingLimits(seconds=0.001, seconds_per_mb=0.0))
    with pytest.raises(ValueError, match=r"has not come to an end after 0 s"):
        read_apart("stl", tmp_path / "ball.stl")


@pytest.mark.whole
def test_a_reader_does_not_import_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trimesh.py").write_text("raise SystemExit(0)")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    monkeypatch.chdir(tmp_path)
    assert len(read_apart("stl", tmp_path / "ball.stl")["faces"]) == 80


def test_the_program_refuses_with_words_and_a_code_of_its_own(tmp_path: Path) -> None:
    import subprocess

    done = subprocess.run(
        [sys.executable, "-P", "-m", "fpplab.core.foreign", "ply", str(2_000_000_000)],
        input=b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n",
        capture_output=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == foreign.REFUSED
    assert done.stdout == b""
    assert b"Traceback" not in done.stderr
    assert done.stderr.strip()
