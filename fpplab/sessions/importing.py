"""Loose images from elsewhere -> a session."""

from __future__ import annotations

import hashlib
import re
import shutil
import string
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from fpplab.core.conventions import Image, full_scale, raw_dtype
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session


def import_images(
    folder: Path,
    plan: Plan,
    names: str,
    out: Path,
    bits: int = 8,
    force: bool = False,
    progress: Progress = no_progress,
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
        A format of the index, from 0, such as "f_{index:02d}.png".
    out : Path
        Directory of the session.
    bits : int
        Depth of the images' grey levels; 8-bit files hold 8, 16-bit files 10, 12 or 16.
    force : bool
        Whether a session that is there already is replaced.
    progress : callable
        Told the share done, 0 … 1.

    Returns
    -------
    Session
        Complete.

    Raises
    ------
    ConfigError
        The folder or the format of the names is wrong, or the output exists.
    DataError
        An image is missing, damaged, coloured, of another size or depth, or there twice under two names.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is not a folder")
    paths = [folder / _name(names, i) for i in range(plan.images)]
    _check_all_there(folder, paths, names)
    size = _check_images(paths, bits)
    session = Session.create(out, plan, force=force)
    try:
        for index, (_, _, pattern) in enumerate(plan.steps()):
            image = _read_grey(paths[index], bits, size)
            settings = CameraSettings(plan.exposure_s, 0.0, bits)
            session.write(Frame(image, index, settings, paths[index].stat().st_mtime, pattern_id=pattern))
            progress((index + 1) / plan.images)
    except BaseException:  # an import is whole or not at all: unlike a scan it costs nothing to repeat
        shutil.rmtree(session.path)
        raise
    return session


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


def _check_all_there(folder: Path, paths: list[Path], names: str) -> None:
    missing = [p.name for p in paths if not p.is_file()]
    if missing:
        shown = ", ".join(missing[:5]) + (" …" if len(missing) > 5 else "")
        raise DataError(
            f"{folder}: {len(missing)} of the plan's {len(paths)} frames are missing ({shown}); "
            f"looked for '{names}' from index 0"
        )


def _check_images(paths: list[Path], bits: int) -> tuple[int, int]:
    """Size of the images, which are all of one kind and no two the same."""
    size: tuple[int, int] | None = None
    seen: dict[bytes, Path] = {}
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
    assert size is not None  # a plan has at least one fringe set
    return size


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
    if int(image.max(initial=0)) > full_scale(bits):
        raise DataError(f"{path}: has a grey level of {image.max()}, more than {bits} bits hold; see --bits")
    if size is not None and image.shape[::-1] != size:
        found = " x ".join(map(str, image.shape[::-1]))
        raise DataError(f"{path}: is {found} pixels but the first image is {size[0]} x {size[1]}")
    return image.astype(raw_dtype(bits))
