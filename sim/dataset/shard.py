"""A shard on disk: a folder with one NumPy file for each field, samples along its first axis.

It is written to a hidden draft folder, which gets its final name once everything in it is on disk, so that a
shard under its final name is complete. A draft belongs to the process that holds the lock of the
file next to it, which the operating system releases when the process dies; the next one starts it again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import NDArray

from fpplab.core.errors import DataError
from fpplab.core.files import flush_folder, open_regular, read_bounded, writing
from fpplab.core.lock import locked_file
from fpplab.core.strict_json import parse_object
from fpplab.patterns.plan import Plan

Arrays = dict[str, NDArray[np.generic]]  # arrays of one sample by field


@dataclass(frozen=True)
class FieldSpec:
    """Description of one array of every sample."""

    name: str  # name of the field
    source: Literal["camera", "measured", "truth"]  # "camera" is what was recorded
    dtype: str  # numPy type string; empty for the frames, whose type depends on the camera
    shape: str  # dimensions separated by spaces
    unit: str  # unit of the values
    meaning: str  # what the values are

    def extent(self, dimensions: dict[str, int]) -> tuple[int, ...]:
        return tuple(dimensions[side] if side in dimensions else int(side) for side in self.shape.split())


FRAMES = "frames"  # name of the field with the camera's images
FIELDS = (
    FieldSpec(FRAMES, "camera", "", "N h w", "raw levels", "the camera's integers, images in the plan's "
          "order, at one of its exposures after the other"),
    FieldSpec("exposure_s", "camera", "<f8", "", "s", "exposure in place of the plan's 'exposure_s', to "
          "which all its exposures keep their ratio"),
    FieldSpec("wrapped_phase", "measured", "<f4", "S h w", "rad", "phase of each fringe set in [0, 2π), "
          "demodulated from the frames; noise alone where no fringes fall"),
    FieldSpec("decoded_u", "measured", "<f4", "h w", "projector px", "column that decoding finds; NaN "
          "where it finds none, or the plan does not code it"),
    FieldSpec("decoded_v", "measured", "<f4", "h w", "projector px", "row that decoding finds, likewise"),
    FieldSpec("decoded_sigma", "measured", "<f4", "h w", "projector px", "standard uncertainty of the "
          "first of these that is coded, NaN where invalid"),
    FieldSpec("modulation", "measured", "<f4", "h w", "levels of 255", "amplitude of the finest set of the "
          "first coded axis, NaN where invalid"),
    FieldSpec("absolute_phase", "truth", "<f4", "S h w", "rad", "phase of each fringe set at the true "
          "projector coordinate, NaN outside the mask"),
    FieldSpec("projector_u", "truth", "<f4", "h w", "projector px", "true column of what the pixel's centre "
          "sees, NaN outside the mask"),
    FieldSpec("projector_v", "truth", "<f4", "h w", "projector px", "true row, likewise"),
    FieldSpec("depth", "truth", "<f4", "h w", "mm", "z in the camera's frame, NaN where nothing is seen"),
    FieldSpec("normals", "truth", "<f4", "3 h w", "1", "unit normal x, y, z in the camera's frame, towards "
          "the camera, NaN where nothing is seen"),
    FieldSpec("mask", "truth", "|b1", "h w", "1", "the pixel's centre sees the surface, and the projector "
          "lights it"),
    FieldSpec("camera_matrix", "truth", "<f8", "3 3", "px", "the true camera"),
    FieldSpec("camera_distortion", "truth", "<f8", "8", "1", "k1 k2 p1 p2 k3 k4 k5 k6 of OpenCV"),
    FieldSpec("projector_matrix", "truth", "<f8", "3 3", "px", "the true projector"),
    FieldSpec("projector_distortion", "truth", "<f8", "8", "1", "likewise"),
    FieldSpec("T_projector_camera", "truth", "<f8", "4 4", "mm", "takes coordinates in the camera's frame "
          "to the projector's"),
)  # fmt: skip


def dimension_sizes(plan: Plan, size: tuple[int, int]) -> dict[str, int]:
    """Look up the lengths that the letters in `FieldSpec.shape` stand for."""
    # size (int, int)
    return {"N": plan.frames, "S": len(plan.fringe_indices), "h": size[1], "w": size[0]}


CHECKSUMS, SCENES = "sha256.json", "scenes.jsonl"
"""Files besides the arrays: checksums of all others, and a line for each sample with all that was drawn."""


def shard_name(number: int) -> str:
    return f"shard_{number:05d}"


def draft_name(number: int) -> str:
    return f".{shard_name(number)}"


@contextmanager
def claim_shard(folder: Path, number: int) -> Iterator[Path | None]:
    """Open an empty draft of a shard, which is renamed to the shard when the block ends."""
    final = folder / shard_name(number)
    draft = folder / draft_name(number)
    with writing(final), ExitStack() as stack:
        is_mine = stack.enter_context(locked_file(draft.with_name(f"{draft.name}.lock")))
        if not is_mine or final.exists():
            yield None
            return
        draft.mkdir(exist_ok=True)
        for remnant in draft.iterdir():
            remnant.unlink()
        try:
            yield draft
            flush_folder(draft)
            draft.rename(final)
            flush_folder(folder)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise


class ShardWriter:
    """Writes samples in turn; leaving the `with` block puts everything on disk, checksums last."""

    def __init__(
        self, draft: Path, fields: dict[str, FieldSpec], samples: int, dimensions: dict[str, int]
    ) -> None:
        self._draft, self._stack = draft, ExitStack()
        self._files = {SCENES: self._open(SCENES)}
        for name, field in fields.items():
            head = {
                "descr": field.dtype,
                "fortran_order": False,
                "shape": (samples, *field.extent(dimensions)),
            }
            self._files[array_file(name)] = self._open(array_file(name))
            np.lib.format.write_array_header_2_0(self._files[array_file(name)], head)  # type: ignore[no-untyped-call]
        self._fields, self._dimensions = fields, dimensions

    def _open(self, name: str) -> _Hashed:
        return self._stack.enter_context(_Hashed(self._draft / name))

    def add(self, arrays: Arrays, scene: dict[str, Any]) -> None:
        for name, field in self._fields.items():
            array = np.asarray(arrays[name], order="C")
            assert (array.dtype.str, array.shape) == (field.dtype, field.extent(self._dimensions)), name
            self._files[array_file(name)].write(array.reshape(-1).view(np.uint8).data)
        self._files[SCENES].write(json.dumps(scene).encode() + b"\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        if error is None:
            sums = {name: file.digest for name, file in sorted(self._files.items())}
            with _Hashed(self._draft / CHECKSUMS) as file:
                file.write(json.dumps(sums, indent=1).encode() + b"\n")


def array_file(field: str) -> str:
    return f"{field}.npy"


class _Hashed:
    """A file being written, with the checksum of its content."""

    def __init__(self, path: Path) -> None:
        self._stream, self._hash = path.open("wb"), hashlib.sha256()

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()

    def write(self, data: bytes | memoryview) -> int:
        self._hash.update(data)
        return self._stream.write(data)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stream:
            self._stream.flush()
            os.fsync(self._stream.fileno())


def check_shard(shard: Path) -> None:
    try:
        sums = parse_object(read_bounded(shard / CHECKSUMS, 1_000_000))  # bytes
        for name, expected in sums.items():
            if Path(name).name != name:
                raise DataError(f"{shard / CHECKSUMS}: names '{name}', which is not in its folder")
            with open_regular(shard / name) as stream:
                if hashlib.file_digest(cast(BufferedReader, stream), "sha256").hexdigest() != expected:
                    raise DataError(
                        f"{shard / name}: is damaged, its checksum is not the shard's; remove {shard} and "
                        "run the same `fpplab dataset` again"
                    )
    except (OSError, ValueError, AttributeError) as error:
        raise DataError(
            f"{shard}: is not a complete shard ({error}); remove it and run the same `fpplab dataset` again"
        ) from error
