"""Loose images from elsewhere -> a session."""

from __future__ import annotations

import hashlib
import re
import string
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from fpplab.core.conventions import Image, Lattice, full_scale, raw_dtype
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.sessions.lock import only_writer
from fpplab.sessions.session import RigRecord, Session, need_space_for_frames


def import_images(
    folder: Path,
    plan: Plan,
    names: str,
    out: Path,
    bits: int = 8,
    force: bool = False,
    progress: Progress = no_progress,
    *,
    first: int = 0,
    projector_size: tuple[int, int] | None = None,
    lattice: Lattice = Lattice.SQUARE,
    warn: Callable[[str], object] = ignore,
) -> Session:
    """Bring grey images of a folder into a new session, in the plan's order.

    Every file is checked before the session is made.

    Parameters
    ----------
    folder : Path
        Where the images are.
    plan : Plan
        What they show: `plan.images` of them.
    names : str
        A format of the index, such as "f_{index:02d}.png". No other file of the folder may have such a name.
    out : Path
        Directory of the session.
    bits : int
        Depth of the images' grey levels; 8-bit files hold 8, 16-bit files 10, 12 or 16. Levels of 10 or 12
        bits that were recorded in the upper bits of 16 are moved to the lower ones.
    force : bool
        Whether a session that is there already is replaced.
    progress : callable
        Told the share done, 0 … 1.
    first : int
        Index of the first image.
    projector_size : tuple of int, optional
        (width, height) in px of the projector that showed the patterns; by default as the plan says.
    lattice : Lattice
        How its mirrors lie.
    warn : callable
        Given a sentence for everything that is accepted but may be a mistake.

    Returns
    -------
    Session
        Complete.

    Raises
    ------
    ConfigError
        The folder or the format of the names is wrong, the output exists, or the size of the projector is
        not known or is not the plan's.
    DataError
        An image is missing, damaged, coloured, of another size or depth, or there twice under two names; or
        there are more than the plan has.
    """
    _check_source(folder, bits)
    rig = _projector_record(plan, projector_size, lattice)
    paths = [folder / _name(names, first + i) for i in range(plan.images)]
    _check_all_there(folder, paths, names, first)
    size, shift = _check_images(paths, bits, warn)

    def fill(session: Session) -> None:
        for index, (_, _, pattern) in enumerate(plan.steps()):
            image = _read_raw(paths[index], bits, size, shift)
            settings = CameraSettings(plan.exposure_s, 0.0, bits)
            session.write(Frame(image, index, settings, paths[index].stat().st_mtime, pattern_id=pattern))
            progress((index + 1) / plan.images)

    with only_writer(out):  # an import is whole or not at all: unlike a scan it costs nothing to repeat
        need_space_for_frames([out], plan, size, bits, force, replaced_last=True)
        return Session.create_whole(out, plan, rig, force, fill)


def read_images(folder: Path, names: str, bits: int = 8, first: int = 0) -> list[Image]:
    """Read the grey images of a folder, in the order of their indices.

    Parameters
    ----------
    folder : Path
        Where the images are.
    names : str
        A format of the index, such as "f_{index:02d}.png".
    bits : int
        Depth of the images' grey levels, as for `import_images`.
    first : int
        Index of the first image.

    Returns
    -------
    list of ndarray of uint8 or uint16, (height, width) each
        All that there are.

    Raises
    ------
    ConfigError
        The folder or the format of the names is wrong.
    DataError
        There is no image, one is missing between two others, or as for `import_images`.
    """
    _check_source(folder, bits)
    _name(names, first)
    last = max((index for index in _indices(folder, names) if index >= first), default=None)
    if last is None:
        raise DataError(f"{folder}: has no image '{names}' from index {first}")
    paths = [folder / _name(names, index) for index in range(first, last + 1)]
    _check_all_there(folder, paths, names, first)
    size, shift = _check_images(paths, bits, ignore)
    return [_read_raw(path, bits, size, shift) for path in paths]


def _check_source(folder: Path, bits: int) -> None:
    if bits not in (8, 10, 12, 16):
        raise ConfigError(f"--bits is {bits}: one of 8, 10, 12, 16")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is not a folder")


def _name(names: str, index: int) -> str:
    try:
        fields = [field for _, field, _, _ in string.Formatter().parse(names) if field is not None]
        if fields != ["index"] or len(names) > 200 or re.search(r"\d{3,}[dx]?}", names):
            raise ValueError
        return names.format(index=index)
    except (ValueError, KeyError, IndexError):
        raise ConfigError(
            f"--frames is '{names}': expected one {{index}}, such as 'f_{{index:02d}}.png'"
        ) from None


def _projector_record(plan: Plan, size: tuple[int, int] | None, lattice: Lattice) -> RigRecord:
    """What the session's record says of the projector, in the form of a rig; None where the plan says all."""
    if size is None and plan.projector_size is None:
        raise ConfigError(
            "--projector-size is missing, and the plan's fringes have no 'projector_size': say how many "
            "pixels the projector has, such as '--projector-size 912 1140' and, where its mirrors lie in a "
            "diamond, '--lattice diamond'"
        )
    if size is not None:
        plan.check_projector(size, "--projector-size")
    size = size or plan.projector_size
    if size == plan.projector_size and lattice is Lattice.SQUARE:
        return None
    assert size is not None
    return {"resolved": {"projector": {"size": list(size), "lattice": str(lattice)}}}


def _check_all_there(folder: Path, paths: list[Path], names: str, first: int) -> None:
    """Refuse a folder that lacks frames of the plan or has more of the same name."""
    there = _indices(folder, names)
    surplus = [index for index in there if not first <= index < first + len(paths)]
    missing = [p.name for p in paths if not p.is_file()]
    if missing:
        counted = there and there[0] != first and there == list(range(there[0], there[0] + len(paths)))
        hint = f"; they count from {there[0]}: --first {there[0]}" if counted else ""
        raise DataError(
            f"{folder}: {len(missing)} of the plan's {len(paths)} frames are missing ({_shown(missing)}); "
            f"looked for '{names}' from index {first}{hint}"
        )
    if surplus:
        found = _shown([_name(names, index) for index in surplus])
        raise DataError(
            f"{folder}: has {len(surplus)} images more than the plan's {len(paths)} ({found}): the plan "
            "lacks fringe sets or steps, or these files belong elsewhere"
        )


def _indices(folder: Path, names: str) -> list[int]:
    """Indices, ascending, of the files whose names have the form given."""
    parts = string.Formatter().parse(names)
    form = "".join(re.escape(text) + (r"(\d+)" if field else "") for text, field, _, _ in parts)
    found = [int(match[1]) for p in folder.iterdir() if (match := re.fullmatch(form, p.name, re.ASCII))]
    return sorted({index for index in found if (folder / _name(names, index)).is_file()})


def _shown(names: list[str]) -> str:
    return ", ".join(names[:5]) + (" …" if len(names) > 5 else "")


def _check_images(paths: list[Path], bits: int, warn: Callable[[str], object]) -> tuple[tuple[int, int], int]:
    """Size of the images, which are all of one kind and no two the same, and their unused lower bits."""
    size: tuple[int, int] | None = None
    seen: dict[bytes, Path] = {}
    used = greatest = 0
    brightest = paths[0]
    for path in paths:
        image = _read_grey(path, bits, size)
        # A sensor never gives the same image twice: a file was copied under two names.
        twin = seen.setdefault(hashlib.sha256(image.data).digest(), path)
        if twin is not path:
            raise DataError(
                f"{path}: is the same image as {twin.name}; every step has an image of its own: "
                "find the one that was copied by mistake"
            )
        height, width = image.shape
        size = width, height
        used |= int(np.bitwise_or.reduce(image, axis=None))
        if int(image.max()) > greatest:
            greatest, brightest = int(image.max()), path
    assert size is not None  # a plan has at least one fringe set
    lossy = [p.name for p in paths if _is_jpeg(p)]
    if lossy:
        warn(
            f"{len(lossy)} of the images are JPEG files ({_shown(lossy)}): their compression adds errors "
            "that no stated uncertainty counts; record PNG or TIFF"
        )
    return size, _unused_bits(used, greatest, brightest, bits, warn)


def _unused_bits(used: int, greatest: int, path: Path, bits: int, warn: Callable[[str], object]) -> int:
    """How many lower bits are zero in every level of every image because `bits` were left-justified in 16."""
    spare = (used & -used).bit_length() - 1 if used else 0
    if greatest <= full_scale(bits):
        held = next((depth for depth in (10, 12) if bits == 16 and spare >= 16 - depth), None)
        if held:
            warn(
                f"every grey level is a multiple of {1 << 16 - held}: the images seem to hold {held} bits in "
                f"the upper bits of 16; with --bits {held} saturated pixels are recognised"
            )
        return 0
    if spare >= 16 - bits:
        warn(f"the {bits} bits are the upper ones of 16 in these images; they were moved to the lower ones")
        return 16 - bits
    raise DataError(f"{path}: has a grey level of {greatest}, more than {bits} bits hold; see --bits")


def _is_jpeg(path: Path) -> bool:
    with Pillow.open(path) as picture:
        return picture.format in ("JPEG", "MPO")


def _read_raw(path: Path, bits: int, size: tuple[int, int], shift: int) -> Image:
    """One grey image as the session has it, without unused lower bits."""
    return (_read_grey(path, bits, size) >> shift).astype(raw_dtype(bits))


def _read_grey(path: Path, bits: int, size: tuple[int, int] | None) -> Image:
    """One grey image, whole; refuses what is not exactly what was promised."""
    try:
        with Pillow.open(path) as picture:
            picture.load()
            mode = picture.mode
            image: Image = np.asarray(picture)
    except Exception as error:
        raise DataError(f"{path}: is truncated or no image ({error})") from error
    if mode not in ("L", "I;16", "I;16B", "I;16L"):
        raise DataError(f"{path}: is not a grey image (its mode is {mode}); convert it to one grey channel")
    depth = 8 if mode == "L" else 16
    if (depth == 8) != (bits == 8):
        raise DataError(f"{path}: holds {depth}-bit grey levels but {bits} bits were promised; see --bits")
    if size is not None and image.shape[::-1] != size:
        found = " x ".join(map(str, image.shape[::-1]))
        raise DataError(f"{path}: is {found} pixels but the first image is {size[0]} x {size[1]}")
    return image.astype(raw_dtype(8 if mode == "L" else 16))
