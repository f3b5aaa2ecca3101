"""The directory of a session: what it holds at first, what may be replaced, space for its frames."""

import glob
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

from fpplab.core import config
from fpplab.core.checksums import write_recorded
from fpplab.core.conventions import raw_dtype
from fpplab.core.disk_space import disk_bytes, need_space
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.file_kinds import other_kind
from fpplab.core.files import no_such_file, sweep_file_drafts, write_text, writing
from fpplab.core.journals import cut_torn_line, whole_lines
from fpplab.core.session_names import FRAMES, JOURNAL, PLAN, RIG, SESSION_FILES
from fpplab.patterns.plan import Plan
from fpplab.sessions.format import write_format
from fpplab.sessions.journal import format_text
from fpplab.sessions.rig_record import RigRecord


def write_initial_files(path: Path, plan: Plan, rig: RigRecord) -> None:
    write_recorded(path / PLAN, config.dump(plan), keep=True)
    if rig is not None:
        write_recorded(path / RIG, config.to_yaml(rig), keep=True)
    write_format(path)
    write_text(path / JOURNAL, "")


def remove_incomplete_files(path: Path) -> None:
    for draft in (path / FRAMES).glob(".*"):
        draft.unlink()
    for name in SESSION_FILES:
        sweep_file_drafts(path / name)
    cut_torn_line(path / JOURNAL)


def remove_session(path: Path) -> None:
    """Delete a session that is to be replaced; nothing that fpplab did not write into it is ever deleted."""
    require_session(path)
    with writing(path), tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as aside:
        # As a whole, or on Windows not at all: while a program has one of its files open.
        path.rename(Path(aside) / path.name)


def remove_temporary_folders(path: Path) -> None:
    for draft in path.parent.glob(f".{glob.escape(path.name)}.*"):
        if draft.is_dir() and [inside.name for inside in draft.iterdir()] == [path.name]:
            shutil.rmtree(draft)


def require_session(path: Path) -> None:
    if not (path / JOURNAL).is_file():
        raise DataError(f"{path}: is not a session, so --force does not replace it; remove it yourself")
    if foreign := _foreign_file_names(path):
        shown = ", ".join(foreign[:5]) + (f" and {len(foreign) - 5} more" if len(foreign) > 5 else "")
        raise DataError(
            f"{path}: holds files that are not part of a session ({shown}), so --force does not replace "
            "it; move them elsewhere, or name another output"
        )


def _foreign_file_names(path: Path) -> list[str]:
    """Names of what fpplab did not write into a session; drafts of its own files count as written."""
    names = "|".join(map(re.escape, sorted(SESSION_FILES)))
    own = re.compile(rf"{names}|\.({names})\.[a-z0-9_]{{8}}")
    frame = re.compile(r"\d{4,}_.*\.tif|\.\d{4,}_.*\.tif\.[a-z0-9_]{8}")
    around = [
        entry for entry in path.iterdir() if entry.name != FRAMES or not entry.is_dir() or entry.is_symlink()
    ]
    frames = path / FRAMES
    inside = frames.iterdir() if frames.is_dir() and not frames.is_symlink() else ()
    foreign = [entry.name for entry in around if entry.is_dir() or not own.fullmatch(entry.name)]
    foreign += [
        f"{FRAMES}/{entry.name}" for entry in inside if entry.is_dir() or not frame.fullmatch(entry.name)
    ]
    return sorted(foreign)


def why_no_session(path: Path) -> str:
    if not path.exists():
        return no_such_file(path)
    missing = " and ".join(name for name in (PLAN, JOURNAL) if not (path / name).is_file())
    reason = other_kind(path, "session") or f"{path}: is not a session (it has no {missing})"
    around = path.parent.parent if path.parent.name == FRAMES else path.parent
    is_inside = all((around / name).exists() for name in (PLAN, JOURNAL, FRAMES))
    return f"{reason}; did you mean the session {around}?" if is_inside else reason


def require_session_folder(path: Path) -> None:
    if path.exists() and not (path / JOURNAL).is_file():
        raise ConfigError(f"{path}: exists and is not a session; name another output")


def need_space_for_frames(
    paths: Sequence[Path],
    plan: Plan,
    size: tuple[int, int],
    bits: int,
    force: bool,
    *,
    replaced_last: bool = False,
) -> None:
    # Frames that interrupted sessions have already need no more space, and a session that is replaced frees
    # its own.
    # size (width, height) px
    images = freed = 0
    for path in paths:
        begun = (path / JOURNAL).is_file()
        images += plan.frames - (len(whole_lines(path / JOURNAL)) if begun and not force else 0)
        freed += disk_bytes(path) if begun and force and not replaced_last else 0
    each = size[0] * size[1] * raw_dtype(bits).itemsize
    what = f"{images} frames of {format_text((*size, bits))}"
    need_space(paths[0] if len(paths) == 1 else paths[0].parent, images * each, what, freed)
