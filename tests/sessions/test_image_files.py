"""Files of grey images that are what they seem, and others."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image as Pillow

from fpplab.core.errors import DataError
from fpplab.sessions.image_files import grey_images, places_in
from tests.support.recorded import image_of

STACK = np.array([image_of(index) for index in range(5)])
DEEP = STACK.astype(np.uint16) * 257 + 3


def levels(path: Path) -> np.ndarray[Any, Any]:
    return np.array([image.levels for image in grey_images(places_in(path))])


@pytest.mark.parametrize("stack", [STACK, DEEP, DEEP.astype(">u2"), STACK[0], DEEP[:4].reshape(2, 2, 16, 20)])
@pytest.mark.parametrize("kind", ["npy", "npz", "packed"])
def test_arrays_are_read_image_by_image(tmp_path: Path, stack: np.ndarray[Any, Any], kind: str) -> None:
    path = tmp_path / "whatever.bin"
    with path.open("wb") as stream:
        if kind == "npy":
            np.save(stream, stack)
        else:
            (np.savez if kind == "npz" else np.savez_compressed)(stream, stack)
    found = levels(path)
    np.testing.assert_array_equal(found, stack.reshape(-1, 16, 20))
    assert found.dtype == (np.uint8 if stack.dtype.itemsize == 1 else np.uint16)


@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("stack", [STACK, DEEP])
def test_pages_of_a_tiff_file(tmp_path: Path, stack: np.ndarray[Any, Any], compression: str | None) -> None:
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, stack, photometric="minisblack", compression=compression)
    np.testing.assert_array_equal(levels(path), stack)
    assert str(places_in(path)[3]) == f"{path} image 3"
    tifffile.imwrite(path, stack, photometric="minisblack", byteorder=">")
    np.testing.assert_array_equal(levels(path), stack)
    first, *others = [Pillow.fromarray(image) for image in stack]
    first.save(path, save_all=True, append_images=others, compression="tiff_lzw")
    np.testing.assert_array_equal(levels(path), stack)


class Unpickled:
    """Leaves a trace if it is ever unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return open, ("unpickled", "w")


@pytest.mark.parametrize(
    ("array", "complaint"),
    [
        (STACK.astype(np.float32), "is an array of float32; save the camera's own levels as uint8 or uint16"),
        (STACK.astype(np.int16), "is an array of int16"),
        (np.array([Unpickled()], object), "is an array of object"),
        (
            np.moveaxis(np.zeros((5, 40, 60), np.uint8), 0, -1).copy(),
            "40 x 60 x 5: its last axis seems to count",
        ),
        (np.zeros((40, 60, 3), np.uint8), "seems to count images or colours"),
        (np.asfortranarray(STACK), "is an array in column-major order; save np.ascontiguousarray"),
        (np.zeros(7, np.uint8), "is an array of 7; images are"),
        (np.zeros((0, 4, 5), np.uint8), "is an array of 0 x 4 x 5; images are"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_arrays_that_are_no_grey_images(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, array: np.ndarray[Any, Any], complaint: str, packed: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / ("a.npz" if packed else "a.npy")
    if packed:
        np.savez_compressed(path, array)
    else:
        np.save(path, array, allow_pickle=True)
    with pytest.raises(DataError, match=complaint):
        places_in(path)
    assert not (tmp_path / "unpickled").exists()


def test_the_size_of_an_array_is_checked_before_it_is_read(tmp_path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|u1", "fortran_order": False, "shape": (1 << 40, 1 << 20, 1 << 20)}
    )  # type: ignore[no-untyped-call]
    path = tmp_path / "huge.npy"
    path.write_bytes(head.getvalue() + bytes(100))
    with pytest.raises(DataError, match=r"takes 1208925819614629174706176 bytes, and 100 are there"):
        places_in(path)
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("a.npy", head.getvalue() + bytes(100))
    with pytest.raises(DataError, match=r"bytes, and 100 are there"):
        places_in(tmp_path / "huge.npz")


def test_files_with_none_or_several_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, white=STACK[0], frames=STACK)
    with pytest.raises(DataError, match=r"holds 2 arrays \(white, frames\); save one, of all images"):
        places_in(path)
    np.savez(path)
    with pytest.raises(DataError, match=r"is a ZIP archive without an array; unpack it"):
        places_in(path)


@pytest.mark.parametrize("kind", ["npy", "npz", "tif"])
def test_a_stack_cut_off_or_altered(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"stack.{kind}"
    if kind == "tif":
        tifffile.imwrite(path, STACK, photometric="minisblack", compression="zlib")
    elif kind == "npy":
        np.save(path, STACK)
    else:
        np.savez_compressed(path, STACK)
    whole = path.read_bytes()
    for length in range(0, len(whole), len(whole) // 20):
        path.write_bytes(whole[:length])
        with pytest.raises(DataError, match="is truncated or" if length else "is empty"):
            levels(path)
    if kind == "npz":
        middle = len(whole) // 2
        path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 4]) + whole[middle + 1 :])
        with pytest.raises(DataError, match="is truncated or damaged"):
            levels(path)


def test_pages_that_do_not_belong_together(tmp_path: Path) -> None:
    path = tmp_path / "stack.tif"
    with tifffile.TiffWriter(path) as file:
        file.write(STACK[0], photometric="minisblack")
        file.write(STACK[0][:8, :8], photometric="minisblack")
    with pytest.raises(DataError, match=r"stack.tif image 1: is 8 x 8 pixels but the first image is 20 x 16"):
        levels(path)
    tifffile.imwrite(
        path, np.arange(2 * 16 * 20 * 3, dtype=np.uint8).reshape(2, 16, 20, 3), photometric="rgb"
    )
    with pytest.raises(DataError, match=r"stack.tif image 0: is in colour"):
        levels(path)


def test_a_negative_is_turned_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "negative.tif"
    tifffile.imwrite(path, 255 - STACK[0], photometric="miniswhite")
    np.testing.assert_array_equal(levels(path)[0], STACK[0])
    tifffile.imwrite(path, DEEP[0], photometric="miniswhite")
    with pytest.raises(DataError, match="is a negative"):
        levels(path)


def test_loss_is_told_by_the_file_and_not_by_its_name(tmp_path: Path) -> None:
    Pillow.fromarray(STACK[0]).save(tmp_path / "a.jpg")
    Pillow.fromarray(STACK[0]).save(tmp_path / "b.tif", compression="jpeg")
    Pillow.fromarray(STACK[0]).save(tmp_path / "c.tif")
    (tmp_path / "a.jpg").rename(tmp_path / "a.png")
    for name, lossy in {"a.png": True, "b.tif": True, "c.tif": False}.items():
        assert [image.is_lossy for image in grey_images(places_in(tmp_path / name))] == [lossy], name
