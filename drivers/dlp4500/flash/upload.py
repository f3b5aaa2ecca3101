"""Upload of a built firmware file: only the sectors that differ, continued after an interruption.

The projector's program is never erased, except for what shares a sector with the flash table; a file that
was built on another program is refused. While images are written, their first sector contains a progress
page instead: a digest of the file, and a mark for each further sector that is written and verified. The
first sector is written last. The projector therefore has either all images of a file or none, and an upload
that was interrupted continues where it was, from any computer. The sector with the table is written only
when the images move, which they do once: from their place in TI's file.
"""

import hashlib
from dataclasses import dataclass

from drivers.dlp4500.flash import memory
from drivers.dlp4500.flash.firmware import MAX_IMAGES, SPLASH_ENTRY, TABLE_SECTOR, Firmware, FlashBlock
from drivers.dlp4500.flash.loader import BootLoaderLink
from drivers.dlp4500.protocol import IMAGES_IN_FLASH
from drivers.dlp4500.transport import Link
from fpplab.core.errors import DataError, DeviceError
from fpplab.core.progress import Progress

_SLOT = 16  # bytes of the digest and of each mark on the progress page (chosen: 128 bits of SHA-256)
_MARK = bytes(_SLOT)


@dataclass(frozen=True)
class UploadPlan:
    """The steps of an upload."""

    images: range  # sectors of the images
    written: frozenset[int] | None  # sectors that an earlier upload of the same file has completed
    table: bool  # whether the flash table must be changed

    @property
    def sectors(self) -> list[int]:
        """Sectors to erase and write, in order; the first sector of the images is last, making them valid."""
        rest = [s for s in self.images[1:] if s not in (self.written or ())]
        return [*rest, *([TABLE_SECTOR] if self.table else []), self.images[0]]

    @property
    def summary(self) -> list[str]:
        """Sentences that tell the operator what will be erased."""
        first, last = self.images[0], self.images[-1]
        sentences = [
            f"Sectors {first} to {last} ({_range(first, last)}) with the images there now will be erased."
        ]
        if self.written is not None:
            sentences.append(
                f"Of these {len(self.written)} are kept: an earlier upload of this file wrote them."
            )
        if self.table:
            sentences.append(
                f"Sector {TABLE_SECTOR} ({_range(TABLE_SECTOR, TABLE_SECTOR)}) with the flash table will be "
                "erased and written back: if power fails just then, only the boot loader starts until the "
                "same command is given again."
            )
        return [*sentences, "The boot loader and the rest of the program are not changed."]


def check_firmware(firmware: Firmware) -> range:
    splash, images = firmware.splash, firmware.images
    if splash.offset % memory.SECTOR or splash.offset < firmware.behind_program or not images:
        raise DataError(
            f"{firmware.source}: its images share sectors with its program; upload what "
            "`fpplab dlp4500 build` makes of it"
        )
    return range(memory.sector_of(splash.offset), memory.sector_of(splash.end - 1) + 1)


def plan_upload(firmware: Firmware, loader: BootLoaderLink) -> UploadPlan:
    """Determine the steps of an upload, without changing anything."""
    images = check_firmware(firmware)
    _check_program(firmware, loader)
    page = _ProgressPage(firmware, loader, images)
    return UploadPlan(
        images, page.written() if page.matches_file() else None, _table_differs(firmware, loader)
    )


def perform_upload(firmware: Firmware, loader: BootLoaderLink, work: UploadPlan, report: Progress) -> None:
    """Erase, write and verify the sectors of a plan; after a failure a new plan continues where it was."""
    page = _ProgressPage(firmware, loader, work.images)
    if work.written is None:
        page.begin()
    for done, sector in enumerate(work.sectors):
        report(done / len(work.sectors))
        loader.erase(sector)
        loader.write(sector * memory.SECTOR, _content(firmware, sector))
        if sector in work.images[1:]:
            page.mark(sector)


def verify_image_count(firmware: Firmware, link: Link) -> None:
    """Compare the number of images that the projector finds in its flash with that of the file."""
    count, expected = link.read(IMAGES_IN_FLASH)["count"], firmware.images
    if count != expected % MAX_IMAGES:  # the count is one byte, in which 256 is 0
        raise DeviceError(
            link.name,
            "upload",
            f"the projector finds {count} images in its flash, not {expected}",
            "give the same command again",
        )


class _ProgressPage:
    """Progress of an upload, stored in the first sector of the images until these are complete."""

    def __init__(self, firmware: Firmware, loader: BootLoaderLink, images: range) -> None:
        self._firmware, self._loader, self._images = firmware, loader, images
        self._offset = images[0] * memory.SECTOR
        self._digest = hashlib.sha256(firmware.content).digest()[:_SLOT]

    def begin(self) -> None:
        """Erase the first sector of the images and write the file's digest to it."""
        self._loader.erase(self._images[0])
        self._loader.write(self._offset, self._digest)

    def matches_file(self) -> bool:
        return self._loader.read(self._offset, _SLOT) == self._digest

    def written(self) -> frozenset[int]:
        """List the sectors that are marked and whose checksum is right."""
        return frozenset(s for s in self._images[1:] if self._is_marked(s) and self._holds(s))

    def mark(self, sector: int) -> None:
        self._loader.write(self._mark_of(sector), _MARK)

    def _mark_of(self, sector: int) -> int:
        return self._offset + _SLOT * (sector - self._images[0])

    def _is_marked(self, sector: int) -> bool:
        return self._loader.checksum(self._mark_of(sector), _SLOT) == memory.flash_checksum(_MARK)

    def _holds(self, sector: int) -> bool:
        return _is_same(self._firmware, self._loader, _sector_of_firmware(self._firmware, sector))


def _check_program(firmware: Firmware, loader: BootLoaderLink) -> None:
    """Refuse a projector with another program; the table's sector is left out, as it may be half written."""
    for block in firmware.blocks:
        start = max(block.offset, (TABLE_SECTOR + 1) * memory.SECTOR)
        rest = FlashBlock(start, block.end - start)
        if rest.size > 0 and not _is_same(firmware, loader, rest):
            raise DeviceError(
                loader.name,
                "upload",
                f"its program is not that of {firmware.source} at {rest.offset:#x} … {rest.end:#x}",
                "build on the firmware that the projector runs",
            )


def _table_differs(firmware: Firmware, loader: BootLoaderLink) -> bool:
    """Tell whether the flash table's sector must be written; equal checksums alone may be a coincidence."""
    entry = firmware.content[SPLASH_ENTRY : SPLASH_ENTRY + 4]
    return loader.read(SPLASH_ENTRY, 4) != entry or not _is_same(
        firmware, loader, _sector_of_firmware(firmware, TABLE_SECTOR)
    )


def _is_same(firmware: Firmware, loader: BootLoaderLink, block: FlashBlock) -> bool:
    """Tell whether the checksum of the projector's flash is that of the file."""
    expected = memory.flash_checksum(firmware.content[block.offset : block.end])
    return loader.checksum(block.offset, block.size) == expected


def _sector_of_firmware(firmware: Firmware, sector: int) -> FlashBlock:
    """Return a sector as far as the file extends."""
    start = sector * memory.SECTOR
    return FlashBlock(start, min(memory.SECTOR, len(firmware.content) - start))


def _content(firmware: Firmware, sector: int) -> bytes:
    part = _sector_of_firmware(firmware, sector)
    return firmware.content[part.offset : part.end]


def _range(first: int, last: int) -> str:
    return f"{first * memory.SECTOR:#x} … {(last + 1) * memory.SECTOR - 1:#x}"
