"""A session: one measurement as a directory, readable after a crash at any moment.

    plan.yaml       what was projected
    rig.yaml        what with, as resolved (absent for imported images)
    journal.jsonl   one line per frame that is safely on disk, with its checksum
    frames/         one uncompressed TIFF per frame, memory-mappable
    decoded.npz, cloud.ply, calibration.yaml ...   results, beside them

A frame is in the session once its line stands whole in the journal: the file is written
atomically first, the line after it. A torn last line is a frame that was not recorded.
"""

from __future__ import annotations

import glob
import hashlib
import io
import json
import logging
import shutil
import time
from collections.abc import Callable, Container, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from pydantic import ValidationError

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Image, Lattice, raw_dtype
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import (
    append_line,
    cut_torn_line,
    disk_bytes,
    make_directory,
    need_space,
    refuse_existing,
    whole_lines,
    write_parts,
    write_text,
)
from fpplab.core.progress import Progress, no_progress
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.response import Curve

PLAN, RIG, JOURNAL, FRAMES = "plan.yaml", "rig.yaml", "journal.jsonl", "frames"

_log = logging.getLogger(__name__)

RigRecord = dict[str, Any] | None
"""A rig as `Rig.described` gives it, or None for images from elsewhere."""


class FrameRecord(Document):
    """One line of the journal."""

    index: int
    """Of the image in the plan, from 0."""
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

    @property
    def format(self) -> tuple[int, int, int]:
        """(width, height, bits)."""
        return self.width, self.height, self.bits

    @property
    def settings(self) -> CameraSettings:
        """The camera's settings at this frame."""
        return CameraSettings(self.exposure_s, self.gain_db, self.bits)


class Session:
    """A recorded, or growing, measurement; made by `create`, `open` or `resume`.

    Attributes
    ----------
    path : Path
        Its directory.
    plan : Plan
        What was projected.
    """

    def __init__(self, path: Path, plan: Plan, records: dict[int, FrameRecord]) -> None:
        self.path, self.plan, self._records = path, plan, records

    def __repr__(self) -> str:
        return f"<Session {self.path}: {len(self._records)} of {self.plan.images} frames>"

    @classmethod
    def create(cls, path: Path, plan: Plan, rig: RigRecord = None, force: bool = False) -> Session:
        """Make a new, empty session.

        Parameters
        ----------
        path : Path
            Its directory.
        plan : Plan
            What will be projected.
        rig : dict or None
            The rig as `Rig.described` gives it; None for images from elsewhere.
        force : bool
            Whether a session that is there already is replaced.

        Returns
        -------
        Session
            Without frames.

        Raises
        ------
        ConfigError
            `path` exists and `force` is not said.
        DataError
            What is there is no session, or the disk is full.
        """
        refuse_existing(path, force)
        if path.exists():
            _remove(path)
        make_directory(path, lambda draft: _furnish(draft, plan, rig))
        _log.info("session %s made for %d frames", path, plan.images)
        return cls(path, plan, {})

    @classmethod
    def create_whole(
        cls, path: Path, plan: Plan, rig: RigRecord, force: bool, fill: Callable[[Session], object]
    ) -> Session:
        """Make a session that appears only once it has all its frames.

        Parameters
        ----------
        path : Path
            Its directory.
        plan : Plan
            What was projected.
        rig : dict or None
            The rig as `Rig.described` gives it; None for images from elsewhere.
        force : bool
            Whether a session that is there already is replaced, once the new one is complete.
        fill : callable
            Writes every frame into the session that it is given.

        Returns
        -------
        Session
            Complete.

        Raises
        ------
        ConfigError, DataError
            As `create`; what `fill` raises. Nothing is left behind then, and what was there stays.
        """
        refuse_existing(path, force)
        if path.exists():
            _require_session(path)
        _sweep(path)
        session = cls(path, plan, {})

        def furnish(draft: Path) -> None:
            _furnish(draft, plan, rig)
            session.path = draft
            fill(session)
            if path.exists():
                _remove(path)

        make_directory(path, furnish)
        session.path = path
        return session

    @classmethod
    def open(cls, path: Path | str) -> Session:
        """Open an existing session.

        Parameters
        ----------
        path : Path or str
            Its directory.

        Returns
        -------
        Session
            With the frames that its journal has.

        Raises
        ------
        DataError
            There is none, or its journal is damaged.
        """
        path = Path(path)
        if not (path / PLAN).is_file() or not (path / JOURNAL).is_file():
            raise DataError(f"{path}: is not a session (it has no {PLAN} and {JOURNAL})")
        plan = config.load_document(path / PLAN, Plan)
        records = _read_journal(path, plan)
        _log.info("session %s opened: %d of %d frames", path, len(records), plan.images)
        return cls(path, plan, records)

    @classmethod
    def resume(
        cls,
        path: Path,
        plan: Plan,
        rig: RigRecord = None,
        force: bool = False,
        complete_too: bool = False,
    ) -> Session:
        """Open the interrupted session at a place, or make a new one.

        Parameters
        ----------
        path : Path
            Its directory.
        plan : Plan
            What is to be projected.
        rig : dict or None
            The rig as `Rig.described` gives it.
        force : bool
            Whether a session that is there already is replaced.
        complete_too : bool
            Whether one that is complete is opened, instead of refused.

        Returns
        -------
        Session
            With the frames recorded until now.

        Raises
        ------
        ConfigError
            It is complete.
        DataError
            It is of another plan, rig or mounted item.
        """
        if force or not (path / JOURNAL).is_file():
            return cls.create(path, plan, rig, force)
        session = cls.open(path)
        if not session.records:  # it stopped before its first frame: nothing is lost
            return cls.create(path, plan, rig, force=True)
        if session.plan != plan:
            raise DataError(f"{path}: was begun with another plan; name another output, or add --force")
        if rig is not None and (began := session.rig()) != rig:
            what = "item or pose" if _but_mounted(began) == _but_mounted(rig) else "rig"
            raise DataError(f"{path}: was begun with another {what}; name another output, or add --force")
        if not session.missing() and not complete_too:
            refuse_existing(path, force)
        _tidy(path)
        return session

    def rig(self) -> RigRecord:
        """Give the rig as resolved when the session was made.

        Returns
        -------
        dict or None
            As `Rig.described` gave it; None for imported images.
        """
        path = self.path / RIG
        return config.parse_yaml(config.read_text(path), path) if path.is_file() else None

    @property
    def is_imported(self) -> bool:
        """Whether the images were recorded by another program."""
        return "name" not in (self.rig() or {})

    @property
    def records(self) -> list[FrameRecord]:
        """The journal, in the order of the plan."""
        return [self._records[i] for i in sorted(self._records)]

    def record(self, index: int) -> FrameRecord:
        """Give the journal's line of one frame.

        Parameters
        ----------
        index : int
            Of the image in the plan.

        Returns
        -------
        FrameRecord
            The line.

        Raises
        ------
        DataError
            The frame is not recorded.
        """
        if index not in self._records:
            raise DataError(f"{self.path}: frame {index} is not recorded")
        return self._records[index]

    def missing(self) -> list[int]:
        """List the plan's images that are not recorded yet.

        Returns
        -------
        list of int
            Their indices, in order.
        """
        return [i for i in range(self.plan.images) if i not in self._records]

    def write(self, frame: Frame) -> None:
        """Put one frame on disk and then into the journal.

        Parameters
        ----------
        frame : Frame
            With the plan's index and pattern id.

        Raises
        ------
        DataError
            There is no space, the frame is recorded already, or the plan has another pattern there.
        """
        pattern = frame.pattern_id or ""
        _check_place(frame.index, pattern, _pattern_ids(self.plan), self._records, self.path)
        name = _file_name(frame.index, pattern)
        image = np.ascontiguousarray(frame.image)
        with ThreadPoolExecutor(max_workers=1) as beside:  # neither holds Python's lock
            checksum = beside.submit(_checksum, image)
            write_parts(self.path / name, tiff_head(image.shape, image.dtype), image.data)
        height, width = image.shape
        record = FrameRecord(
            index=frame.index,
            pattern=pattern,
            file=name,
            sha256=checksum.result(),
            width=width,
            height=height,
            bits=frame.settings.bits,
            exposure_s=frame.settings.exposure_s,
            gain_db=frame.settings.gain_db,
            host_time_s=frame.host_time_s,
            device_time_s=frame.device_time_s,
        )
        append_line(self.path / JOURNAL, json.dumps(record.model_dump()))
        self._records[frame.index] = record

    def read(self, index: int, verify: bool = True) -> Image:
        """Read one frame, checked against the journal.

        Parameters
        ----------
        index : int
            Of the image in the plan.
        verify : bool
            Whether its checksum is compared.

        Returns
        -------
        ndarray of uint8 or uint16, (height, width)
            Memory-mapped and read-only.

        Raises
        ------
        DataError
            It is missing, truncated, altered or of another kind than the journal says.
        """
        record = self.record(index)
        path = self.path / record.file
        try:
            image: Image = tifffile.memmap(path, mode="r")
        except FileNotFoundError:
            raise DataError(f"{path}: frame {index} is missing") from None
        except Exception as error:
            raise DataError(f"{path}: frame {index} is truncated or damaged ({error})") from error
        expected = raw_dtype(record.bits)
        if image.dtype != expected or image.shape != (record.height, record.width):
            raise DataError(
                f"{path}: frame {index} is {image.dtype} {image.shape[::-1]} but the journal says "
                f"{expected} {(record.width, record.height)}"
            )
        if verify and _checksum(image) != record.sha256:
            raise DataError(f"{path}: frame {index} is corrupt: its checksum is not the journal's")
        return image

    def stack(self, verify: bool = True, progress: Progress = no_progress) -> list[Image]:
        """Read every frame of the plan.

        Parameters
        ----------
        verify : bool
            Whether checksums are compared.
        progress : callable
            Told the share done, 0 … 1.

        Returns
        -------
        list of ndarray, (height, width) each
            In the plan's order, memory-mapped and read-only.

        Raises
        ------
        DataError
            Frames are missing, or of another size than the first; the message names them.
        """
        if missing := self.missing():
            shown = ", ".join(map(str, missing[:8])) + (" …" if len(missing) > 8 else "")
            raise DataError(
                f"{self.path}: {len(missing)} of {self.plan.images} frames are missing ({shown}); "
                "run the same scan again to complete it"
            )
        images, start = [], time.perf_counter()
        with ThreadPoolExecutor(2) as readers:  # checksums do not hold Python's lock
            for i, record in enumerate(self.records):
                if record.format != self.format:
                    raise DataError(
                        f"{self.path / record.file}: frame {i} is {_shown(record.format)}, "
                        f"but the first is {_shown(self.format)}"
                    )
            for image in readers.map(lambda i: self.read(i, verify), range(self.plan.images)):
                images.append(image)
                progress(len(images) / self.plan.images)
        seconds = time.perf_counter() - start
        _log.info(
            "%d frames of %s read from %s, %.3f s", len(images), _shown(self.format), self.path, seconds
        )
        return images

    def recording(self, verify: bool = True, progress: Progress = no_progress) -> Recording:
        """Give all frames with everything that decoding must know of them.

        Parameters
        ----------
        verify : bool
            Whether checksums are compared with the journal's.
        progress : callable
            Told the share done, 0 … 1.

        Returns
        -------
        Recording
            Its frames memory-mapped and read-only.

        Raises
        ------
        ConfigError
            The projector cannot show the plan.
        DataError
            As `stack` and `projector`.
        """
        size, _ = self.projector()
        self.plan.check_projector(size, self.path)
        frames = self.stack(verify, progress)
        return Recording(frames, self.plan, size, self.bits, str(self.path), self.response())

    def response(self) -> Curve | None:
        """Give the measured response of the rig that took the frames, where its file states one.

        Returns
        -------
        Curve or None
            The response.

        Raises
        ------
        ConfigError
            The rig's record holds something else.
        """
        found = (self.rig() or {}).get("response")
        return None if found is None else config.validate(found, Curve, f"{self.path}: response of the rig")

    @property
    def bits(self) -> int:
        """Depth of the frames' grey levels."""
        return self.format[2]

    @property
    def format(self) -> tuple[int, int, int]:
        """(width, height, bits) of the first frame.

        Raises
        ------
        DataError
            There are no frames yet.
        """
        if not self._records:
            raise DataError(f"{self.path}: has no frames yet")
        return self.records[0].format

    def projector(self) -> tuple[tuple[int, int], Lattice]:
        """Tell which projector showed the patterns.

        From the rig as recorded, or for images from elsewhere from the plan, on a square lattice.

        Returns
        -------
        size : tuple of int
            (width, height) in px.
        lattice : Lattice
            How the mirrors lie.

        Raises
        ------
        DataError
            Neither says.
        """
        rig = self.rig()
        if rig is None and self.plan.projector_size:
            return self.plan.projector_size, Lattice.SQUARE
        try:
            found = (rig or {})["resolved"]["projector"]
            return (int(found["size"][0]), int(found["size"][1])), Lattice(found["lattice"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise DataError(
                f"{self.path}: does not say how many pixels the projector had, and in which lattice; "
                "add 'projector_size' to the plan's fringes and import the images again"
            ) from error


def _but_mounted(rig: RigRecord) -> dict[str, Any]:
    """A rig's record without what was mounted on it."""
    resolved = (rig or {}).get("resolved") or {}
    return {**(rig or {}), "resolved": {k: v for k, v in resolved.items() if k != "mounted"}}


def _file_name(index: int, pattern: str) -> str:
    return f"{FRAMES}/{index:04d}_{pattern}.tif"


def _shown(form: tuple[int, int, int]) -> str:
    return f"{form[0]} x {form[1]} at {form[2]} bits"


@cache
def tiff_head(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    """Give what stands before the pixels of an image in the file that tifffile writes.

    Parameters
    ----------
    shape : tuple of int
        (height, width).
    dtype : dtype
        Of the pixels.

    Returns
    -------
    bytes
        The head of the file.
    """
    image, file = np.zeros(shape, dtype), io.BytesIO()
    tifffile.imwrite(file, image, photometric="minisblack", metadata=None)
    return file.getvalue()[: -image.nbytes]


def _checksum(image: NDArray[Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(image).data).hexdigest()


def _furnish(path: Path, plan: Plan, rig: RigRecord) -> None:
    write_text(path / PLAN, config.dump(plan))
    if rig is not None:
        write_text(path / RIG, config.to_yaml(rig))
    write_text(path / JOURNAL, "")


def _pattern_ids(plan: Plan) -> list[str]:
    return [name for _, _, name in plan.steps()]


def _check_place(index: int, pattern: str, ids: list[str], taken: Container[int], where: Path | str) -> None:
    if index in taken:
        raise DataError(f"{where}: frame {index} is recorded already")
    if not 0 <= index < len(ids) or pattern != ids[index]:
        raise DataError(
            f"{where}: frame {index} shows '{pattern}', which is not what the plan has there: "
            "the frames are of another plan"
        )


def _read_journal(path: Path, plan: Plan) -> dict[int, FrameRecord]:
    ids = _pattern_ids(plan)
    records: dict[int, FrameRecord] = {}
    for number, line in enumerate(whole_lines(path / JOURNAL), 1):
        where = f"{path / JOURNAL} line {number}"
        try:
            record = FrameRecord.model_validate_json(line)
        except ValidationError as error:
            raise DataError(f"{where}: is not a frame's record ({config.describe(error)})") from error
        _check_place(record.index, record.pattern, ids, records, where)
        if record.file != _file_name(record.index, record.pattern):
            raise DataError(
                f"{where}: frame {record.index} names the file '{record.file}', which is not its own"
            )
        records[record.index] = record
    return records


def _tidy(path: Path) -> None:
    """Take away what a crash left: half a frame's file, and a torn last line of the journal."""
    for draft in (path / FRAMES).glob(".*"):
        draft.unlink()
    cut_torn_line(path / JOURNAL)


def _remove(path: Path) -> None:
    """Delete a session that is to be replaced; nothing else is ever deleted."""
    _require_session(path)
    shutil.rmtree(path)


def _sweep(path: Path) -> None:
    """Take away drafts of a session whose process was killed."""
    for draft in path.parent.glob(f".{glob.escape(path.name)}.*"):
        if draft.is_dir() and [inside.name for inside in draft.iterdir()] == [path.name]:
            shutil.rmtree(draft)


def _require_session(path: Path) -> None:
    if not (path / JOURNAL).is_file():
        raise DataError(f"{path}: is not a session, so --force does not replace it; remove it yourself")


def refuse_foreign(path: Path) -> None:
    """Refuse, before anything is done, an output for a session that is something else.

    Parameters
    ----------
    path : Path
        The output.

    Raises
    ------
    ConfigError
        It exists and is no session.
    """
    if path.exists() and not (path / JOURNAL).is_file():
        raise ConfigError(f"{path}: exists and is not a session; name another output")


def need_space_for_frames(
    paths: Sequence[Path],
    plan: Plan,
    size: tuple[int, int],
    bits: int,
    force: bool = False,
    *,
    replaced_last: bool = False,
) -> None:
    """Refuse sessions whose frames do not fit on the disk, before anything is projected or written.

    Frames that interrupted sessions have already need no more space, and a session that is replaced frees its
    own.

    Parameters
    ----------
    paths : sequence of Path
        Directories of the sessions, on one disk.
    plan : Plan
        What each of them records.
    size : tuple of int
        (width, height) of a frame in px.
    bits : int
        Depth of its grey levels.
    force : bool
        Whether sessions that are there already are replaced.
    replaced_last : bool
        Whether they free their space only when the new ones are complete.

    Raises
    ------
    DataError
        There is too little space.
    """
    images = freed = 0
    for path in paths:
        begun = (path / JOURNAL).is_file()
        images += plan.images - (len(whole_lines(path / JOURNAL)) if begun and not force else 0)
        freed += disk_bytes(path) if begun and force and not replaced_last else 0
    each = size[0] * size[1] * raw_dtype(bits).itemsize
    what = f"{images} frames of {_shown((*size, bits))}"
    need_space(paths[0] if len(paths) == 1 else paths[0].parent, images * each, what, freed)


def recorded_sessions(paths: list[Path]) -> list[Session]:
    """Open sessions that are named one by one, or by the directory that holds them.

    Parameters
    ----------
    paths : list of Path
        Sessions, or directories of sessions.

    Returns
    -------
    list of Session
        All of one plan and format.

    Raises
    ------
    ConfigError
        One is given twice.
    DataError
        A path holds none, or they do not belong together.
    """
    sessions: list[Session] = []
    for path in paths:
        alone = (path / JOURNAL).is_file()
        inside = [] if alone else sorted(p.parent for p in path.glob(f"*/{JOURNAL}"))
        sessions += [Session.open(p) for p in inside or [path]]
    places = [session.path.resolve() for session in sessions]
    for place in places:
        if places.count(place) > 1:
            raise ConfigError(f"{place}: is given twice; a pose counts once")
    first = sessions[0]
    for session in sessions[1:]:
        if session.plan != first.plan:
            raise DataError(f"{session.path}: was taken with another plan than {first.path}")
        if session.format != first.format:
            raise DataError(
                f"{session.path}: has frames of {_shown(session.format)}, "
                f"but {first.path} of {_shown(first.format)}"
            )
    return sessions
