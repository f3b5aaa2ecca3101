"""Files of foreign parsers, read in a process of its own with limited time, memory and stack.

Run as a program, this module is that process: it reads a file from stdin and writes an NPZ archive to stdout.
"""

import io
import os
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.core.files import open_regular
from fpplab.core.system import system_module


@dataclass(frozen=True)
class ReadingLimits:
    """Limits of the process in which a foreign parser reads a file."""

    seconds: float = 30.0  # time that any file may take (chosen)
    seconds_per_mb: float = 2.0  # time in addition for every MB of the file (chosen)
    address_bytes: int = 1_600_000_000  # address space that reading any file may take (chosen)
    address_per_byte: int = 40  # address space in addition for every byte of the file (chosen)
    stack_bytes: int = 1 << 20  # stack of the thread that reads, which limits the depth of recursion (chosen)


LIMITS = ReadingLimits()

REFUSED = 3  # exit code where the parser itself refused the file (chosen): Python's own are 1 and 2

OPENCV_STARTS = ("%YAML", "<?xml", "{")
"""What files of OpenCV's FileStorage begin with, where they have a header."""

Parts = dict[str, NDArray[Any]]


def read_apart(kind: str, path: Path) -> Parts:
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        seconds = LIMITS.seconds + LIMITS.seconds_per_mb * size / 1e6
        command = [
            sys.executable,
            "-P",
            "-m",
            __name__,
            kind,
            str(LIMITS.address_bytes + LIMITS.address_per_byte * size),
        ]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        try:
            read = subprocess.run(
                command, stdin=stream, capture_output=True, timeout=seconds, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"its reader has not come to an end after {seconds:.0f} s") from None
    if read.returncode == 0:
        with np.load(io.BytesIO(read.stdout), allow_pickle=False) as parts:
            return dict(parts)
    if read.returncode == REFUSED:
        raise ValueError(read.stderr.decode("utf-8", "replace").strip())
    raise ValueError("its reader fails on it; is it damaged, or nested without end?")


def _read_stdin_in_child(kind: str, max_bytes: int) -> None:
    """Read stdin in a thread of little stack, and write what it holds to stdout."""
    import threading

    _limit_memory(max_bytes)
    threading.stack_size(LIMITS.stack_bytes)
    result: list[Parts | str] = []
    thread = threading.Thread(target=lambda: result.append(_read(kind, sys.stdin.buffer)))
    thread.start()
    thread.join()
    if not result:
        sys.exit(1)
    if isinstance(result[0], str):
        print(result[0], file=sys.stderr)
        sys.exit(REFUSED)
    np.savez(sys.stdout.buffer, **result[0])


def _limit_memory(max_bytes: int) -> None:
    resource = system_module("resource")
    if resource is None:  # Windows
        return
    with suppress(ValueError, OSError):  # a system with a stricter limit, or without it
        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _read(kind: str, stream: BinaryIO) -> Parts | str:
    try:
        read_calibration = CALIBRATIONS.get(kind)
        content = stream.read()
        return read_calibration(content) if read_calibration else read_mesh(kind, content)
    except MemoryError:
        return "it asks for more memory than a file of its size can need"
    except Exception as error:  # noqa: BLE001 - parsers raise exceptions of any kind
        return str(error) or type(error).__name__


def read_mesh(kind: str, content: bytes) -> Parts:
    # returns (N, 3)
    import trimesh

    if kind == "stl" and content:
        _check_stl(content)
    elif kind == "obj":
        _check_obj(content)
    elif kind == "ply":
        content = _checked_ply(content)
    with np.errstate(invalid="ignore"):
        # Unprocessed, since processing would silently drop corners that are not finite.
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        return {}
    return {"vertices": np.asarray(mesh.vertices, np.float64), "faces": np.asarray(mesh.faces, np.int64)}


def _check_stl(content: bytes) -> None:
    """Raise `ValueError` for an STL file with other faces than it announces, which trimesh hides."""
    announced = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * announced:
        return
    text = content.lower()
    if text.lstrip().startswith(b"solid") and (b"facet" in text or b"endsolid" in text):
        begun, ended = text.count(b"facet normal"), text.count(b"endfacet")
        if begun != ended or b"endsolid" not in text:
            raise ValueError(
                f"it is cut off: {ended} of {begun} faces are complete, or 'endsolid' is missing"
            )
    elif content[:84].isascii() and content[:84].replace(b"\n", b"").decode("ascii").isprintable():
        raise ValueError("it is a text that does not begin with 'solid'")
    elif len(content) < 84:
        raise ValueError(f"it ends after {len(content)} bytes, within its header")
    elif len(content) < 84 + 50 * announced:
        raise ValueError(
            f"it is cut off or its count is wrong: it holds {(len(content) - 84) // 50} of {announced} faces"
        )
    else:
        excess = len(content) - 84 - 50 * announced
        raise ValueError(f"{excess} bytes follow the {announced} faces that it announces")


def _check_obj(content: bytes) -> None:
    """Raise `ValueError` for rows of an OBJ file that are too short, which trimesh leaves out."""
    for number, line in enumerate(content.replace(b"\\\n", b" ").splitlines(), 1):
        match line.split():
            case [b"v", *values] if len(values) < 3:
                raise ValueError(f"line {number} has {len(values)} coordinates instead of 3; is it cut off?")
            case [b"f", *corners] if len(corners) < 3:
                raise ValueError(f"line {number} has a face of {len(corners)} corners; is it cut off?")
            case [b"f", *corners] if any(corner.split(b"/")[0] == b"0" for corner in corners):
                raise ValueError(f"line {number} names corner 0, but OBJ counts corners from 1")


def _checked_ply(content: bytes) -> bytes:
    """Give a PLY file, as text without empty lines; raise `ValueError` for other rows than it announces."""
    head, mark, body = content.partition(b"end_header")
    if not re.search(rb"^format\s+ascii", head, re.MULTILINE):
        return content
    rows = [line for line in body.splitlines() if line.strip()]
    announced = sum(map(int, re.findall(rb"^element\s+\S+\s+(\d+)", head, re.MULTILINE)))
    if len(rows) != announced:
        raise ValueError(f"it has {len(rows)} lines of data, but its header announces {announced}")
    return b"\n".join([head + mark, *rows, b""])


def read_opencv(content: bytes) -> Parts:
    import cv2

    # OpenCV would print what the error says; versions 4 and 5 keep the switch in different places.
    switch: Any = cv2 if hasattr(cv2, "setLogLevel") else getattr(cv2.utils, "logging")  # noqa: B009
    switch.setLogLevel(0)
    try:
        text = content.decode("utf-8-sig")
        if not text.lstrip().startswith(OPENCV_STARTS):
            text = f"%YAML:1.0\n---\n{text.lstrip().removeprefix('---')}"
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()  # valid only as long as `storage` exists
        entries = {name: _opencv_value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError) as error:  # the latter where a matrix is cut off
        raise ValueError("OpenCV refuses it") from error
    return {name: np.asarray(value) for name, value in entries.items() if value is not None}


def _opencv_value(node: Any) -> Any:
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        values = [_opencv_value(node.at(i)) for i in range(node.size())]
        return np.array(values) if all(isinstance(value, float | np.ndarray) for value in values) else None
    import cv2

    try:
        return node.mat() if node.isMap() else None
    except cv2.error:  # a map that is no matrix
        return None


def read_mat(content: bytes) -> Parts:
    """Read the variables of a MAT-file; fields of structures are named with dots."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    try:
        variables = loadmat(io.BytesIO(content))
    except NotImplementedError:
        raise ValueError("it is of version 7.3; in MATLAB, save(..., '-v7') writes one that is") from None
    entries: Parts = {}
    has_objects = "__function_workspace__" in variables
    for name, value in variables.items():
        has_objects |= isinstance(value, MatlabOpaque | MatlabFunction)
        if not name.startswith("__"):
            _add_fields(name, value, entries)
    if has_objects:
        raise ValueError(
            "it holds objects, which only MATLAB can read; s = toStruct(stereoParams); "
            "save('stereo.mat', '-struct', 's', '-v7') writes their fields"
        )
    return entries


def _add_fields(name: str, value: Any, entries: Parts) -> None:
    array = np.asarray(value)
    if array.dtype.names is not None:
        for field in array.dtype.names if array.size == 1 else ():
            _add_fields(f"{name}.{field}", array.flat[0][field], entries)
    elif array.dtype.kind in "biuf":
        entries[name] = array.astype(np.float64)
    elif array.dtype.kind == "U" and array.size == 1:
        entries[name] = np.array(str(array.flat[0]))


def read_mrcal(content: bytes) -> Parts:
    import ast

    model = ast.literal_eval(content.decode("utf-8").strip())
    if not isinstance(model, dict):
        raise ValueError("it is not a dictionary")
    names = ("lensmodel", "intrinsics", "imagersize", "rt_cam_ref", "extrinsics")
    return {name: np.array(model[name]) for name in names if name in model}


CALIBRATIONS = {"opencv": read_opencv, "mat": read_mat, "mrcal": read_mrcal}


if __name__ == "__main__":
    _read_stdin_in_child(sys.argv[1], int(sys.argv[2]))
