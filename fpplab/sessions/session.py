"""A session: one measurement as a directory, readable after a crash at any moment.

    session.yaml    in which version of this format it is
    plan.yaml       what was projected
    rig.yaml        what with, as resolved (absent for imported images)
    files.jsonl     checksums of the files next to it that decide what the frames mean
    journal.jsonl   one line per frame that is safely on disk, with its checksum
    log.jsonl       what was done with it, when, and by which program
    frames/         one uncompressed TIFF per frame, memory-mappable
    decoded.npz, cloud.ply, calibration.yaml ...   results, next to them

A frame is in the session once its line stands whole in the journal: the file is written
atomically first, the line after it. A torn last line is a frame that was not recorded.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fpplab.core import config
from fpplab.core.conventions import Image, Lattice
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import make_directory, refuse_existing
from fpplab.core.journals import append_line
from fpplab.core.notebook import axes_or_new, grey_picture, html_table
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import JOURNAL, PLAN
from fpplab.devices import Frame
from fpplab.patterns.curve import Curve
from fpplab.patterns.mosaic import Bayer
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.sessions.folder import (
    remove_incomplete_files,
    remove_session,
    remove_temporary_folders,
    require_session,
    why_no_session,
    write_initial_files,
)
from fpplab.sessions.folder import require_session_folder as require_session_folder
from fpplab.sessions.format import check_format, upgrade_format
from fpplab.sessions.frame_files import read_frame, write_frame
from fpplab.sessions.journal import (
    FrameRecord,
    check_frame_place,
    check_whole,
    format_text,
    frame_file,
    frame_times,
    pattern_ids,
    read_journal,
)
from fpplab.sessions.rig_record import (
    RigRecord,
    check_same_rig,
    read_rig,
    recorded_bayer,
    recorded_depth,
    recorded_projector,
    recorded_response,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_log = logging.getLogger(__name__)


class Session:
    """A recorded, or growing, measurement; made by `create`, `open` or `resume`.

    Attributes
    ----------
    path : Path
        Its directory.
    plan : Plan
        What was projected.
    """

    def __init__(self, path: Path, plan: Plan, rig: RigRecord, records: dict[int, FrameRecord]) -> None:
        self.path, self.plan, self._rig, self._records = path, plan, rig, records
        self._disk: int | None = None

    def __repr__(self) -> str:
        return f"<Session {self.path}: {len(self._records)} of {self.plan.frames} frames>"

    def _repr_html_(self) -> str:
        missing = len(self.missing())
        rows: dict[str, object] = {
            "folder": self.path,
            "frames": f"{len(self._records)} of {self.plan.frames}",
            "plan": repr(self.plan).removeprefix("<Plan: ").removesuffix(">"),
            "rig": "images from elsewhere" if self.is_imported else (self._rig or {}).get("name"),
            "state": "complete" if not missing else f"{missing} frames are missing",
        }
        if not self._records:
            return html_table("Session", rows)
        width, height, bits = self.format
        rows["camera"] = f"{width} x {height} px, {bits} bits"
        return html_table("Session", rows, grey_picture(self.read(self.records[0].index, verify=False)))

    def plot(self, index: int | None = None, axes: Axes | None = None) -> Axes:
        """Draw one frame.

        Parameters
        ----------
        index : int, optional
            Of the image in the plan; by default the recorded frame with the greatest mean grey level.
        axes : matplotlib.axes.Axes, optional
            Where to draw; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes
            With the frame in grey.

        Raises
        ------
        DataError
            The frame is not recorded, or damaged.
        """
        shown = self._brightest() if index is None else index
        frame, chosen = self.read(shown), axes_or_new(axes)
        chosen.imshow(frame, cmap="gray", vmin=0, vmax=2.0**self.bits - 1, interpolation="nearest")
        chosen.set(title=f"frame {shown}", xlabel="camera column, px", ylabel="camera row, px")
        return chosen

    def _brightest(self) -> int:
        """Index of the recorded frame with the greatest mean grey level; the first of equals."""
        if not self._records:
            raise DataError(f"{self.path}: has no frames yet")
        width, height, _ = self.format
        step = max(1, min(width, height) // 64)  # some thousand pixels tell how bright a frame is
        means = {i: self.read(i, verify=False)[::step, ::step].mean() for i in sorted(self._records)}
        return max(means, key=lambda i: means[i])

    @classmethod
    def create(cls, path: Path | str, plan: Plan, rig: RigRecord = None, force: bool = False) -> Session:
        """Make a new session without frames; `force` replaces one that is there already, and nothing else."""
        path = Path(path)
        refuse_existing(path, force)
        if path.exists():
            remove_session(path)
        make_directory(path, lambda draft: write_initial_files(draft, plan, rig))
        _log.info("session %s made for %d frames", path, plan.frames)
        return cls(path, plan, rig, {})

    @classmethod
    def create_whole(
        cls, path: Path | str, plan: Plan, rig: RigRecord, force: bool, fill: Callable[[Session], object]
    ) -> Session:
        """Make a session that appears once `fill` has written all of its frames."""
        path = Path(path)
        refuse_existing(path, force)
        if path.exists():
            require_session(path)
        remove_temporary_folders(path)
        session = cls(path, plan, rig, {})

        def fill_draft(draft: Path) -> None:
            write_initial_files(draft, plan, rig)
            session.path = draft
            fill(session)
            if path.exists():
                remove_session(path)

        make_directory(path, fill_draft)
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
            There is none, or its plan, its rig or its journal is damaged.
        """
        path = Path(path)
        if not (path / PLAN).is_file() or not (path / JOURNAL).is_file():
            raise DataError(why_no_session(path))
        check_format(path)
        plan, rig = config.load_document(path / PLAN, Plan), read_rig(path)
        records = read_journal(path, plan)
        _log.info("session %s opened: %d of %d frames", path, len(records), plan.frames)
        return cls(path, plan, rig, records)

    @classmethod
    def resume(
        cls,
        path: Path | str,
        plan: Plan,
        rig: RigRecord = None,
        force: bool = False,
        complete_too: bool = False,
    ) -> Session:
        """Open the interrupted session of this plan, rig and item, or make a new one."""
        path = Path(path)
        if force or not (path / JOURNAL).is_file():
            return cls.create(path, plan, rig, force)
        session = cls.open(path)
        if not session.records:  # it stopped before its first frame: nothing is lost
            return cls.create(path, plan, rig, force=True)
        if session.plan != plan:
            raise DataError(f"{path}: was begun with another plan; name another output, or add --force")
        check_same_rig(session.rig(), rig, path)
        if not session.missing() and not complete_too:
            refuse_existing(path, force)
        remove_incomplete_files(path)
        upgrade_format(path)
        return session

    def rig(self) -> RigRecord:
        """Give the rig as resolved when the session was made; None for imported images."""
        return deepcopy(self._rig)

    @property
    def is_imported(self) -> bool:
        """Whether the images were recorded by another program."""
        return "name" not in (self._rig or {})

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
        """List the plan's images that are not recorded yet, by their indices."""
        return [i for i in range(self.plan.frames) if i not in self._records]

    def write(self, frame: Frame) -> None:
        """Put one frame of the plan on disk and then into the journal."""
        self._check_disk()
        pattern = frame.pattern_id or ""
        check_frame_place(frame.index, pattern, pattern_ids(self.plan), self._records, self.path)
        name = frame_file(frame.index, pattern)
        image = np.ascontiguousarray(frame.image)
        record = FrameRecord.of(frame, name, write_frame(self.path / name, image))
        append_line(self.path / JOURNAL, json.dumps(record.model_dump()))
        self._records[frame.index] = record

    def _check_disk(self) -> None:
        """Refuse to write where the session's disk has gone: it would lie beneath the place of the disk."""
        disk = self.path.stat().st_dev if self.path.is_dir() else None
        if disk is None or self._disk not in (None, disk):
            raise DataError(
                f"{self.path}: is not on its disk any more; connect that again and run the same command"
            )
        self._disk = disk

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
        return read_frame(self.path / record.file, record, verify)

    def check_kept(self) -> None:
        """Refuse to call a session complete that somebody has removed, or taken frames from: `DataError`."""
        needed = [JOURNAL, *(record.file for record in self.records)]
        for name in needed:
            if not (self.path / name).is_file():
                raise DataError(
                    f"{self.path}: was removed while it was measured ({name} is gone), so there is no "
                    "result; remove what is left of it and run the same command again"
                )

    def stack(self, verify: bool = True, progress: Progress = no_progress) -> list[Image]:
        """Read every frame of the plan.

        Parameters
        ----------
        verify : bool
            Whether checksums are compared.
        progress : callable
            Called with the share done, 0 … 1.

        Returns
        -------
        list of ndarray, (height, width) each
            In the plan's order, memory-mapped and read-only.

        Raises
        ------
        DataError
            Frames are missing, or of another size than the first; the message names them.
        """
        check_whole(self.path, self.plan, self.records)
        images, start = [], time.perf_counter()
        with ThreadPoolExecutor(2) as readers:  # checksums do not hold Python's lock
            for image in readers.map(lambda i: self.read(i, verify), range(self.plan.frames)):
                images.append(image)
                progress(len(images) / self.plan.frames)
        seconds = time.perf_counter() - start
        _log.info(
            "%d frames of %s read from %s, %.3f s", len(images), format_text(self.format), self.path, seconds
        )
        return images

    def recording(self, verify: bool = True, progress: Progress = no_progress) -> Recording:
        """Give all frames with everything that decoding must know of them.

        Parameters
        ----------
        verify : bool
            Whether checksums are compared with the journal's.
        progress : callable
            Called with the share done, 0 … 1.

        Returns
        -------
        Recording
            Its frames memory-mapped and read-only; those of several exposures merged into one for each image.

        Raises
        ------
        ConfigError
            The projector cannot show the plan, or the rig's response or depths are not valid as recorded.
        DataError
            As `stack` and `projector`.
        """
        raw = self._raw(verify, progress)
        if len(self.plan.exposures) == 1:
            return raw
        from fpplab.phase.exposures import merged_recording  # compiled code, for these sessions alone

        starts = self.plan.pass_starts[:-1]
        return merged_recording(raw, [self.record(first).exposure_s for first in starts])

    def passes(self, verify: bool = True) -> list[Recording]:
        """Give the frames as they are, a recording for each of the plan's exposures."""
        raw, plan = self._raw(verify), self.plan
        return [
            replace(raw, plan=plan.part_at(exposure_s), frames=raw.frames[first:end])
            for exposure_s, (first, end) in zip(plan.exposures, pairwise(plan.pass_starts), strict=True)
        ]

    def _raw(self, verify: bool, progress: Progress = no_progress) -> Recording:
        """All frames of all exposures, one after another."""
        size, lattice = self.projector()
        self.plan.check_projector(size, self.path)
        frames = self.stack(verify, progress)
        known = self.response(), self.depth, self.is_imported, lattice
        raw = Recording(frames, self.plan, size, self.bits, str(self.path), *known, bayer=self.bayer)
        return replace(raw, times_s=() if self.is_imported else frame_times(self.records))

    @property
    def bayer(self) -> Bayer | None:
        """Colours of the filter of the camera that took the frames; None of one without."""
        return recorded_bayer(self._rig, self.path)

    def response(self) -> Curve | None:
        """Give the measured response of the rig that took the frames; None where its file states none."""
        return recorded_response(self._rig, self.path)

    @property
    def depth(self) -> DepthRange | None:
        """Range of distances from the camera that the plan, or else the rig, states."""
        return recorded_depth(self._rig, self.plan, self.path)

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
        """Return which projector showed the patterns.

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
        return recorded_projector(self._rig, self.plan, self.path)


def recorded_sessions(paths: list[Path]) -> list[Session]:
    """Open sessions that are named one by one, or by the directory that holds them."""
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
                f"{session.path}: has frames of {format_text(session.format)}, "
                f"but {first.path} of {format_text(first.format)}"
            )
    return sessions
