"""Clouds and meshes that declare what they do not hold are refused at once, in one sentence."""

import os
from pathlib import Path

import numpy as np
import pytest

from fpplab.clouds import load_cloud, load_mesh
from fpplab.core import archives
from fpplab.core.errors import DataError
from fpplab.sessions.image_files import open_image_file

HEAD = """ply
format {order} 1.0
element vertex {vertices}
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
def test_more_vertices_than_the_file_has_room_for(tmp_path: Path, order: str) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text(HEAD.format(order=order, vertices=300_000_000) + "0 0 0\n", encoding="ascii")
    with pytest.raises(DataError, match=r"it ends after at most \d of 300000000 vertices"):
        load_cloud(path)


def test_text_without_a_last_newline_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    text = HEAD.format(order="ascii", vertices=2).replace("element face 1\n", "")
    text = text.replace("property list uchar int vertex_indices\n", "")
    path.write_text(text + "0 0 1\n1 2 3", encoding="ascii")
    assert load_cloud(path).points.tolist() == [[0, 0, 1], [1, 2, 3]]


@pytest.mark.nightly
@pytest.mark.parametrize("corner", [7, -1])
def test_a_face_with_a_corner_that_is_not_there(tmp_path: Path, corner: int) -> None:
    path = tmp_path / "part.ply"
    corners = "0 0 0\n1 0 0\n0 1 0\n"
    path.write_text(HEAD.format(order="ascii", vertices=3) + corners + f"3 0 1 {corner}\n", encoding="ascii")
    with pytest.raises(DataError, match=f"a face names corner {corner}, but there are corners 0 to 2"):
        load_mesh(path)


def test_an_archive_that_unpacks_to_far_more_than_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archives, "LIMITS", archives.ArchiveLimits(always_allowed_bytes=1_000_000))
    path = tmp_path / "cloud.npz"
    np.savez_compressed(path, points=np.ones((200_000, 3), np.float32))
    with pytest.raises(DataError, match=r"that unpack to 2\.40 MB, more than 100 times as much"):
        load_cloud(path)
    np.savez_compressed(path, images=np.zeros((40, 300, 300), np.uint8))
    with pytest.raises(DataError, match=r"that unpack to 3\.60 MB"), open_image_file(path):
        pass
    np.savez(path, points=np.ones((200_000, 3), np.float32))
    assert len(load_cloud(path).points) == 200_000


@pytest.mark.parametrize("name", ["a.ply", "a.xyz", "a.npz", "a.stl"])
def test_a_pipe_is_refused_at_once(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    load = load_mesh if name == "a.stl" else load_cloud
    with pytest.raises(DataError, match="it is a pipe or a device, not a file"):
        load(tmp_path / name)
