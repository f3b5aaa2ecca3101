"""Images of other programs -> a session, or the frames themselves."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from fpplab.core.conventions import Image, Lattice, raw_dtype
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.mosaic import Bayer
from fpplab.patterns.plan import Plan
from fpplab.sessions.folder import need_space_for_frames
from fpplab.sessions.grey_depth import StoredLevels, check_bits
from fpplab.sessions.image_files import ImagePlace, grey_images
from fpplab.sessions.image_names import first_names
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.rig_record import RigRecord
from fpplab.sessions.session import Session

DIAMONDS = {(912, 1140): "LightCrafter 4500", (608, 684): "LightCrafter"}
"""Projectors by the (width, height) of their mirrors, which lie in a diamond."""


def import_images(
    source: ImageSelection,
    plan: Plan,
    out: Path,
    bits: int | None = None,
    force: bool = False,
    progress: Progress = no_progress,
    *,
    projector_size: tuple[int, int] | None = None,
    lattice: Lattice | None = None,
    bayer: str | None = None,
    warn: Say = ignore,
    tell: Say = ignore,
) -> Session:
    # Every image is checked before the session is made.
    # projector_size (width, height) px
    check_bits(bits)
    if bayer not in (None, *get_args(Bayer)):
        raise ConfigError(f"--bayer is '{bayer}': must be one of {', '.join(get_args(Bayer))}")
    rig = _projector_record(plan, projector_size, lattice, bayer is not None)
    if bayer is not None and rig is not None:
        rig["resolved"]["camera"] = {"bayer": bayer}
    sizes = [shown.images for each in plan.exposures for shown in plan.part_at(each).sets]
    images = _find_and_check_images(source, sizes, bits, warn, tell)
    patterns = [pattern for _, _, pattern in plan.steps()]
    taken_at = [
        (patterns[i], exposure_s)
        for exposure_s, shown in zip(plan.exposures, plan.passes, strict=True)
        for i in shown
    ]

    def fill(session: Session) -> None:
        for index, ((pattern, exposure_s), image) in enumerate(zip(taken_at, images.read(), strict=True)):
            settings = CameraSettings(exposure_s, 0.0, images.bits)
            taken = images.places[index].path.stat().st_mtime
            session.write(Frame(image, index, settings, taken, pattern_id=pattern))
            progress((index + 1) / plan.frames)

    with exclusive_write(
        out
    ):  # an import is whole or not at all: in contrast to a scan it costs nothing to repeat
        need_space_for_frames([out], plan, images.size, images.bits, force, replaced_last=True)
        return Session.create_whole(out, plan, rig, force, fill)


def read_images(
    source: ImageSelection, bits: int | None = None, *, warn: Say = ignore, tell: Say = ignore
) -> tuple[list[Image], int]:
    # returns images (height, width)
    check_bits(bits)
    images = _find_and_check_images(source, None, bits, warn, tell)
    return list(images.read()), images.bits


@dataclass(frozen=True)
class _CheckedImages:
    """Images of one size and depth, no two of them the same."""

    places: list[ImagePlace]
    size: tuple[int, int]
    bits: int
    shift: int  # by how many bits stored levels are moved down

    def read(self) -> Iterator[Image]:
        for image in grey_images(self.places):
            yield (image.levels >> self.shift).astype(raw_dtype(self.bits))


def _find_and_check_images(
    source: ImageSelection, sets: list[int] | None, bits: int | None, warn: Say, tell: Say
) -> _CheckedImages:
    places = source.images(sets, warn, tell)
    size, stored = (0, 0), 8
    earlier: dict[bytes, ImagePlace] = {}
    lossy: list[str] = []
    levels = StoredLevels()
    stated: dict[int, ImagePlace] = {}
    for place, image, is_lossy, stated_bits in grey_images(places):
        # A sensor never gives the same image twice: a file was copied under two names.
        twin = earlier.setdefault(hashlib.sha256(np.ascontiguousarray(image).data).digest(), place)
        if twin is not place:
            raise DataError(
                f"{place}: is the same image as {twin.name}; every step has an image of its own: "
                "find the one that was copied by mistake"
            )
        depth = 8 * image.dtype.itemsize
        if place is places[0]:
            size, stored = (image.shape[1], image.shape[0]), depth
            if depth == 8 and bits not in (None, 8):
                raise DataError(f"{place}: holds 8-bit grey levels but {bits} bits were stated; see --bits")
        elif depth != stored:
            raise DataError(f"{place}: holds {depth}-bit grey levels but the first image {stored}-bit ones")
        if depth > 8:
            levels.add(image, str(place))
        if stated_bits is not None:
            stated.setdefault(stated_bits, place)
        lossy += [place.name] if is_lossy else []
    if lossy:
        warn(
            f"{len(lossy)} images are compressed with loss, as JPEG files are ({first_names(lossy)}): that "
            "adds errors that no stated uncertainty counts; record PNG or TIFF"
        )
    if stored == 8:
        return _CheckedImages(places, size, 8, 0)
    return _CheckedImages(places, size, *levels.depth(_known_bits(bits, stated), warn, tell))


def _known_bits(bits: int | None, stated: dict[int, ImagePlace]) -> int | None:
    """The depth by the command line or by the files' heads, which must agree."""
    if len(stated) > 1:
        said = " and ".join(f"{depth} bits ({place.name})" for depth, place in stated.items())
        raise DataError(f"the images' heads state {said}: all images of a session have the same depth")
    for depth, place in stated.items():
        if bits is not None and bits > depth:
            raise ConfigError(f"--bits is {bits}, but {place} states that its levels have {depth} bits")
    return bits if bits is not None else next(iter(stated), None)


def _projector_record(
    plan: Plan, size: tuple[int, int] | None, lattice: Lattice | None, always: bool
) -> RigRecord:
    """What the session's record says of the projector, in the form of a rig; None where the plan says all."""
    if size is None and plan.projector_size is None:
        raise ConfigError(
            "--projector-size is missing, and the plan's fringes have no 'projector_size': say how many "
            "pixels the projector has, such as '--projector-size 912 1140', and with '--lattice diamond' or "
            "'--lattice square' how its mirrors lie"
        )
    if size is not None:
        plan.check_projector(size, "--projector-size")
    size = size or plan.projector_size
    assert size is not None
    if lattice is None and size in DIAMONDS:
        raise ConfigError(
            f"--lattice is missing: {size[0]} x {size[1]} are the mirrors of a {DIAMONDS[size]}, which lie "
            "in a diamond; say '--lattice diamond', or '--lattice square' where pixels of the patterns "
            "were not mirrors"
        )
    if not always and size == plan.projector_size and lattice in (None, Lattice.SQUARE):
        return None
    return {"resolved": {"projector": {"size": list(size), "lattice": str(lattice or Lattice.SQUARE)}}}
