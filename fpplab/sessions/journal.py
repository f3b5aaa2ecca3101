"""The journal of a session: one line per frame that is safely on disk, with its checksum."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from pydantic import ValidationError

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import DataError
from fpplab.core.journals import whole_lines
from fpplab.core.session_names import FRAMES, JOURNAL
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan


class FrameRecord(Document):
    """One line of the journal."""

    index: int
    """Of the image in the plan, from 0; those of a further exposure go on from the one before."""
    pattern: str
    """The pattern that was on show."""
    file: str
    """The frame's file, relative to the session."""
    sha256: str
    """Checksum of the pixels."""
    width: int
    """px."""
    height: int
    """px."""
    bits: int
    """Depth of the grey levels."""
    exposure_s: float
    """Exposure in s, as read back."""
    gain_db: float
    """Gain in dB, as read back."""
    host_time_s: float
    """When the frame arrived, s since 1970."""
    device_time_s: float | None = None
    """By the camera's clock in s; None where it has none."""

    @classmethod
    def of(cls, frame: Frame, file: str, sha256: str) -> FrameRecord:
        height, width = frame.image.shape
        return cls(
            index=frame.index,
            pattern=frame.pattern_id or "",
            file=file,
            sha256=sha256,
            width=width,
            height=height,
            bits=frame.settings.bits,
            exposure_s=frame.settings.exposure_s,
            gain_db=frame.settings.gain_db,
            host_time_s=frame.host_time_s,
            device_time_s=frame.device_time_s,
        )

    @property
    def format(self) -> tuple[int, int, int]:
        """(width, height, bits)."""
        return self.width, self.height, self.bits

    @property
    def settings(self) -> CameraSettings:
        return CameraSettings(self.exposure_s, self.gain_db, self.bits)


def format_text(form: tuple[int, int, int]) -> str:
    # form (width, height, bits)
    return f"{form[0]} x {form[1]} at {form[2]} bits"


def frame_file(index: int, pattern: str) -> str:
    return f"{FRAMES}/{index:04d}_{pattern}.tif"


def pattern_ids(plan: Plan) -> list[str]:
    names = [name for _, _, name in plan.steps()]
    return [names[i] for images in plan.passes for i in images]


def check_frame_place(
    index: int, pattern: str, ids: list[str], taken: Container[int], error_prefix: Path | str
) -> None:
    if index in taken:
        raise DataError(f"{error_prefix}: frame {index} is recorded already")
    if not 0 <= index < len(ids) or pattern != ids[index]:
        raise DataError(
            f"{error_prefix}: frame {index} shows '{pattern}', which is not what the plan has there: "
            "the frames are of another plan"
        )


def read_journal(path: Path, plan: Plan) -> dict[int, FrameRecord]:
    ids = pattern_ids(plan)
    records: dict[int, FrameRecord] = {}
    for number, line in enumerate(whole_lines(path / JOURNAL), 1):
        record = _record_of(line, f"{path / JOURNAL} line {number}", ids, records)
        records[record.index] = record
    return records


@dataclass(frozen=True)
class JournalLines:
    """A journal, line by line."""

    records: dict[int, FrameRecord]  # of the lines that are whole, by index of the image in the plan
    faults: tuple[str, ...]  # what is wrong with the others


def readable_lines(path: Path, plan: Plan | None) -> JournalLines:
    ids = None if plan is None else pattern_ids(plan)
    records: dict[int, FrameRecord] = {}
    faults = []
    for number, line in enumerate(whole_lines(path / JOURNAL), 1):
        try:
            record = _record_of(line, f"{path / JOURNAL} line {number}", ids, records)
            records[record.index] = record
        except DataError as error:
            faults.append(str(error))
    return JournalLines(records, tuple(faults))


def _record_of(line: bytes, error_prefix: str, ids: list[str] | None, taken: Container[int]) -> FrameRecord:
    try:
        record = FrameRecord.model_validate_json(line)
    except ValidationError as error:
        raise DataError(f"{error_prefix}: is not a frame's record ({config.describe(error)})") from error
    if ids is not None:
        check_frame_place(record.index, record.pattern, ids, taken, error_prefix)
    if record.file != frame_file(record.index, record.pattern):
        raise DataError(
            f"{error_prefix}: frame {record.index} names the file '{record.file}', which is not its own"
        )
    return record


def check_whole(path: Path, plan: Plan, records: Sequence[FrameRecord]) -> None:
    recorded = {record.index for record in records}
    if missing := [i for i in range(plan.frames) if i not in recorded]:
        shown = ", ".join(map(str, missing[:8])) + (" …" if len(missing) > 8 else "")
        raise DataError(
            f"{path}: {len(missing)} of {plan.frames} frames are missing ({shown}); "
            "run the same scan again to complete it"
        )
    for i, record in enumerate(records):
        if record.format != records[0].format:
            raise DataError(
                f"{path / record.file}: frame {i} is {format_text(record.format)}, "
                f"but the first is {format_text(records[0].format)}"
            )


def frame_times(records: Sequence[FrameRecord]) -> tuple[float, ...]:
    """When frames were taken in s, by the camera's clock if it has one; empty where clocks stand."""
    times = [record.device_time_s for record in records]
    if None in times:
        times = [record.host_time_s for record in records]
    known = tuple(time for time in times if time is not None)
    return known if all(a < b for a, b in pairwise(known)) else ()
