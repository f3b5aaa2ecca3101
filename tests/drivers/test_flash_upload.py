"""Uploads into an emulated flash: only what must be is written, and every interruption can be mended."""

import json
import struct
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from drivers.clock import RealClock
from drivers.dlp4500.flash.firmware import Firmware
from drivers.dlp4500.flash.loader import MAX_DATA_BYTES, BootLoaderLink, boot_loader_session
from drivers.dlp4500.flash.upload import check_firmware, plan_upload, verify_image_count
from drivers.dlp4500.framing import UsbMessage
from drivers.dlp4500.sequence import SIZE
from drivers.dlp4500.transport import Link
from drivers.emulators.dlpc350 import Dlpc350Policy, UsbFault
from drivers.emulators.dlpc350.flash import SPLASH_ADDRESS
from fpplab.cli.every import app
from fpplab.core import confirmation
from fpplab.core.errors import (
    Cancelled,
    ConfigError,
    DataError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    SettingError,
    StateError,
)
from fpplab.patterns.fringes import uniform_patterns
from tests.drivers.flash_board import DATA, ENTER, ERASE, LEAVE, SECTOR, Bench, firmware
from tests.drivers.flash_files import maker_firmware

MAKER = maker_firmware()
PATTERNS = uniform_patterns(list(range(100, 136)), SIZE)
BUILT = firmware(MAKER).with_patterns(PATTERNS, Path("built.bin"))
"""Twelve images, in two sectors."""
OTHER = firmware(MAKER).with_patterns(PATTERNS[::-1], Path("other.bin"))
SMALL = firmware(MAKER).with_patterns(PATTERNS[:3], Path("small.bin"))
"""One image, in one sector."""
TABLE, HEAD, TAIL = 1, 11, 12
BOUNDARY = HEAD * SECTOR


def _messages(policy: Dlpc350Policy | None = None, built: Firmware = BUILT) -> list[int]:
    """What an upload without interruption sends."""
    bench = Bench(MAKER, policy)
    bench.upload(built)
    return bench.board.messages


MESSAGES = _messages()
ERASES = [i for i, number in enumerate(MESSAGES) if number == ERASE]


WHOLE = MAKER.ljust(256 * SECTOR, b"\xff")
UNTOUCHED = np.frombuffer(WHOLE, np.uint8)


def _has(bench: Bench, built: Firmware) -> bool:
    """Whether the file is in the flash, and nothing behind it changed."""
    flash, size = np.frombuffer(bench.board.flash.content, np.uint8), len(built.content)
    end = -(-size // SECTOR) * SECTOR
    return (
        flash[:size].tobytes() == built.content
        and bool((flash[size:end] == 0xFF).all())
        and np.array_equal(flash[end:].view(np.uint64), UNTOUCHED[end:].view(np.uint64))
    )


def _is_safe(bench: Bench, built: Firmware = BUILT) -> bool:
    """Whether boot loader and program are whole, and the images all there or none.

    What shares the sector of the flash table may be missing while that is written, then the loader must run.
    """
    flash, images = np.frombuffer(bench.board.flash.content, np.uint8), len(bench.board.images)
    boot, program = slice(SECTOR), slice(2 * SECTOR, BOUNDARY)
    whole = all(np.array_equal(flash[part], UNTOUCHED[part]) for part in (boot, program))
    table = slice(SECTOR, 2 * SECTOR)
    valid = flash[table].tobytes() in (MAKER[table], built.content[table])
    return whole and bench.runs_program() == valid and (not valid or images in (0, built.images))


def _interrupted(fails_at: int, policy: Dlpc350Policy | None = None, built: Firmware = BUILT) -> Bench:
    bench = Bench(WHOLE, policy)
    bench.board.fails_at = fails_at
    with suppress(DeviceError):  # at the very end it no longer matters
        bench.upload(built)
    assert _is_safe(bench, built)
    bench.clock.sleep(bench.board.policy.reset_s)
    return bench


def _finish(bench: Bench, built: Firmware = BUILT) -> None:
    bench.upload(built)
    assert _has(bench, built)
    assert bench.runs_program()


def test_the_projector_shows_what_was_built():
    bench = Bench(MAKER)
    bench.upload(BUILT)
    assert _has(bench, BUILT)
    for slot, pattern in enumerate(PATTERNS):
        assert (bench.board.images[slot // 3][..., slot % 3] == pattern.image).all()


def test_first_the_images_then_the_table_and_their_first_sector_last():
    bench = Bench(MAKER)
    words = " ".join(bench.upload(BUILT))
    assert bench.board.erased == [HEAD, TAIL, TABLE, HEAD]
    assert "Sectors 11 to 12 (0x160000 … 0x19ffff)" in words
    assert "Sector 1 (0x20000 … 0x3ffff) with the flash table" in words


def test_later_the_table_stays():
    bench = Bench(MAKER)
    bench.upload(BUILT)
    bench.board.erased = []
    words = " ".join(bench.upload(OTHER))
    assert bench.board.erased == [HEAD, TAIL, HEAD]
    assert "table" not in words
    assert _has(bench, OTHER)


def test_a_table_of_the_same_sum_is_told_apart():
    bench = Bench(BUILT.content)
    moved = bytearray(bench.board.flash.content[SPLASH_ADDRESS : SPLASH_ADDRESS + 4])
    moved[0], moved[2] = moved[2], moved[0]
    bench.board.flash.content[SPLASH_ADDRESS : SPLASH_ADDRESS + 4] = moved
    bench.upload(BUILT)
    assert _has(bench, BUILT)


# --- interruptions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("share", np.linspace(0, 1, 16))
def test_power_may_fail_at_any_time(share):
    _finish(_interrupted(round(share * (len(MESSAGES) - 1))))


@pytest.mark.whole_after(10)
@pytest.mark.parametrize(
    "fails_at",
    [at + shift for at in (MESSAGES.index(ENTER), *ERASES, MESSAGES.index(LEAVE)) for shift in (-1, 0, 1, 2)],
)
def test_power_may_fail_about_what_changes_most(fails_at):
    _finish(_interrupted(fails_at))


FAST = Dlpc350Policy(sector_erase_s=0.02)


@pytest.mark.nightly
def test_power_may_fail_at_every_message():
    """Of one image."""
    messages = _messages(FAST, SMALL)
    assert messages.count(DATA) > SECTOR // MAX_DATA_BYTES, (
        "among them all of the sector with the flash table"
    )
    for fails_at in range(len(messages)):
        _finish(_interrupted(fails_at, FAST, SMALL), SMALL)


@pytest.mark.nightly
def test_power_may_fail_at_every_message_but_data():
    """Of many images, and at every fifth message with data."""
    for fails_at, number in enumerate(_messages(FAST)):
        if number != DATA or fails_at % 5 == 0:
            _finish(_interrupted(fails_at, FAST))


@pytest.mark.parametrize("fault", [UsbFault.UNPLUG_BEFORE, UsbFault.UNPLUG_AFTER])
@pytest.mark.parametrize("share", [0.02, 0.2, 0.4, 0.6, 0.8, 0.98])
def test_the_cable_may_be_pulled(fault, share):
    bench = Bench(MAKER)
    bench.hid.faults[round(share * len(MESSAGES))] = fault
    with pytest.raises(DisconnectedError):
        bench.upload(BUILT)
    bench.hid.plug()
    bench.upload(BUILT)
    assert _has(bench, BUILT)


@pytest.mark.parametrize("fault", [UsbFault.DROP, UsbFault.NACK, UsbFault.LATE])
def test_an_answer_may_be_lost(fault):
    bench = Bench(MAKER)
    bench.hid.faults[MESSAGES.index(ERASE)] = fault
    with pytest.raises(DeviceError, match="erase sector"):
        bench.upload(BUILT)
    bench.clock.sleep(5.0)
    bench.upload(BUILT)
    assert _has(bench, BUILT)


def test_what_was_written_before_an_interruption_stays():
    bench = _interrupted(ERASES[2])
    assert not bench.runs_program()
    bench.board.erased = []
    words = " ".join(bench.upload(BUILT))
    assert "Of these 1 are kept" in words
    assert bench.board.erased == [TABLE, HEAD]
    assert _has(bench, BUILT)


def test_what_another_file_left_is_not_taken_for_this_one():
    """The two have the same sums everywhere: only their progress tells them apart."""
    assert sum(BUILT.content[BOUNDARY:]) == sum(OTHER.content[BOUNDARY:])
    bench = _interrupted(ERASES[2])
    bench.upload(OTHER)
    assert _has(bench, OTHER)


def _shuffle(bench: Bench, start: int, size: int) -> None:
    """Other bytes with the same sum."""
    part = slice(start, start + size)
    bench.board.flash.content[part] = bench.board.flash.content[part][::-1]


def test_sums_alone_do_not_make_a_sector_written():
    bench = _interrupted(ERASES[1] - 1)
    tail = slice(TAIL * SECTOR, len(BUILT.content))
    bench.board.flash.content[tail] = BUILT.content[tail][::-1]
    bench.upload(BUILT)
    assert _has(bench, BUILT)


def test_sums_alone_do_not_make_it_the_progress_of_this_file():
    bench = _interrupted(ERASES[2])
    _shuffle(bench, HEAD * SECTOR, 16)
    _shuffle(bench, TAIL * SECTOR, len(BUILT.content) - TAIL * SECTOR)
    bench.upload(BUILT)
    assert _has(bench, BUILT)


def test_a_marked_sector_that_changed_is_written_again():
    bench = _interrupted(ERASES[2])
    bench.board.flash.erase(TAIL)
    bench.upload(BUILT)
    assert _has(bench, BUILT)


# --- refusals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("sector", [0, -1, 256])
def test_the_boot_sector_is_never_erased(sector):
    bench = Bench(MAKER)
    with pytest.raises(SettingError, match="boot sector"):
        BootLoaderLink(bench.link(), bench.clock, "projector").erase(sector)
    assert bench.board.messages == []


@pytest.mark.parametrize(("offset", "size"), [(0, 1), (SECTOR - 1, 2), (256 * SECTOR - 1, 2)])
def test_the_boot_sector_is_never_written(offset, size):
    bench = Bench(MAKER)
    with pytest.raises(SettingError, match="boot sector"):
        BootLoaderLink(bench.link(), bench.clock, "projector").write(offset, bytes(size))
    assert bench.board.messages == []


def _with_images_at(offset: int) -> Firmware:
    content = bytearray(BUILT.content)
    content[offset : offset + 2060] = BUILT.content[BOUNDARY : BOUNDARY + 2060]
    struct.pack_into("<I", content, SPLASH_ADDRESS, 0xF9000000 + offset)
    return firmware(bytes(content))


@pytest.mark.parametrize("offset", [0x15EFD0, 0x160010, 0x140000, 0x40000, 0])
def test_images_that_share_sectors_with_the_program_are_refused(offset):
    with pytest.raises(DataError, match="images share sectors with its program"):
        check_firmware(_with_images_at(offset))


@pytest.mark.parametrize("beyond", [-1, 0, 1])
def test_sectors_of_the_images_are_those_that_hold_a_byte_of_them(beyond):
    whole = -(-len(BUILT.content) // SECTOR) * SECTOR
    content = BUILT.content + bytes(whole + beyond - len(BUILT.content))
    sectors = check_firmware(firmware(content))
    held = {offset // SECTOR for offset in range(BUILT.splash.offset, len(content))}
    assert list(sectors) == sorted(held)


def test_a_file_of_the_maker_is_refused():
    with pytest.raises(DataError, match="has no images"):
        check_firmware(firmware(MAKER))


def test_another_program_is_refused():
    other = bytearray(MAKER)
    other[0x100000] ^= 1
    bench = Bench(bytes(other))
    with pytest.raises(DeviceError, match=r"its program is not that of .* at 0xe0a40 … 0x15efc8"):
        bench.upload(BUILT)
    assert bench.board.erased == []
    bench.clock.sleep(5.0)
    assert bench.runs_program()


def test_preparing_changes_nothing():
    bench = Bench(MAKER)
    with boot_loader_session(bench.link, bench.clock, "projector") as loader:
        plan_upload(BUILT, loader)
    assert np.array_equal(bench.flash(), UNTOUCHED)


def test_an_identity_of_zeros_is_read_again():
    bench = Bench(MAKER, Dlpc350Policy(blank_identities=3))
    with boot_loader_session(bench.link, bench.clock, "projector") as loader:
        assert plan_upload(BUILT, loader).sectors


def test_another_flash_is_refused(monkeypatch):
    monkeypatch.setattr("drivers.emulators.dlpc350.loader._PART", 0x2201)
    bench = Bench(MAKER)
    with pytest.raises(
        DeviceError, match="the flash is maker 0x0020 part 0x2201, not maker 0x0020 part 0x227e"
    ):
        bench.upload(BUILT)
    assert bench.board.erased == []


def test_flash_that_does_not_take_a_bit_is_found():
    bench = Bench(MAKER)
    write = bench.board.flash.write
    place = TAIL * SECTOR + 100

    def stuck(offset: int, data: bytes) -> None:
        write(offset, data)
        bench.board.flash.content[place] |= 1

    bench.board.flash.content[place] |= 1
    bench.board.flash.write = stuck
    assert not BUILT.content[place] & 1
    with pytest.raises(DeviceError, match=r"checksum of .* bytes at 0x180000 is .*, not .*the same command"):
        bench.upload(BUILT)
    assert _is_safe(bench)


def test_a_flash_that_stays_busy_times_out():
    bench = Bench(MAKER, Dlpc350Policy(sector_erase_s=100.0))
    with pytest.raises(DeviceTimeoutError, match="still busy after 30 s"):
        bench.upload(BUILT)


class Deaf(Bench):
    """A projector that does not enter its boot loader."""

    def __init__(self) -> None:
        super().__init__(MAKER)
        answer = self.board.answer

        def ignoring(message: UsbMessage) -> UsbMessage | None:
            return None if message.payload[:2] == struct.pack("<H", ENTER) else answer(message)

        self.board.answer = ignoring


def test_a_projector_that_stays_in_its_program_is_reported():
    with pytest.raises(StateError, match="does not reappear in its boot loader within 15 s"):
        Deaf().upload(BUILT)


class BusyComputer(Bench):
    """Looks in vain for the projector while it restarts, and does nothing more for a long time."""

    def link(self) -> Link:
        try:
            return super().link()
        except DeviceError:
            self.clock.sleep(20.0)
            raise


def test_a_projector_that_reappeared_while_the_computer_was_busy_is_found():
    assert BusyComputer(MAKER).upload(BUILT)


def test_a_projector_that_finds_other_images_is_reported():
    bench = Bench(MAKER)
    bench.upload(BUILT)
    fewer = firmware(MAKER).with_patterns(PATTERNS[:3], Path("fewer.bin"))
    with pytest.raises(DeviceError, match="finds 12 images in its flash, not 1"):
        verify_image_count(fewer, bench.link())


# --- command ----------------------------------------------------------------------------------------


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> Bench:
    """A projector that the command finds, with the time of the wall."""
    bench = Bench(MAKER, Dlpc350Policy(sector_erase_s=0.0, checksum_s=0.0, reset_s=0.1), RealClock())
    monkeypatch.setitem(sys.modules, "hid", bench.hid)
    return bench


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """What was built."""
    path = tmp_path / "built.bin"
    path.write_bytes(BUILT.content)
    return path


def _run(*words: object, says: str = "") -> Result:
    return CliRunner().invoke(app, ["dlp4500", "upload", *map(str, words)], input=says)


@pytest.fixture
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confirmation, "_has_terminal", lambda: True)


CONSENT = [(["--yes"], ""), (["--allow", "erase-flash"], ""), ([], "y\n")]


@pytest.mark.parametrize(("words", "says"), CONSENT)
def test_the_command(plugged_in, file, words, says, at_a_terminal):
    result = _run(file, *words, "--json", says=says)
    assert result.exception is None
    answer = json.loads(result.stdout)
    assert (answer["sectors"], answer["images"]) == ([TAIL, TABLE, HEAD], 12)
    assert "Sectors 11 to 12 (0x160000 … 0x19ffff)" in " ".join(result.stderr.split())
    assert _has(plugged_in, BUILT)
    assert plugged_in.runs_program()


@pytest.mark.parametrize("says", ["n\n", ""])
def test_without_consent_nothing_is_erased(plugged_in, file, says, at_a_terminal):
    result = _run(file, says=says)
    assert isinstance(result.exception, Cancelled)
    assert plugged_in.board.erased == []
    assert plugged_in.runs_program()


@pytest.mark.parametrize("words", [[], ["--allow", "led-current"]])
def test_without_a_terminal_and_the_flag_nothing_is_sent(plugged_in, file, words):
    result = _run(file, *words, says="y\n")
    assert isinstance(result.exception, ConfigError)
    assert "add --allow erase-flash" in str(result.exception)
    assert plugged_in.board.messages == []


def test_a_dry_run_tells_and_changes_nothing(plugged_in, file):
    before = bytes(plugged_in.board.flash.content)
    result = _run(file, "--dry-run", "--json")
    assert result.exception is None
    assert json.loads(result.stdout) == {"sectors": [TAIL, TABLE, HEAD], "images": 12, "dry_run": True}
    assert plugged_in.board.erased == []
    assert bytes(plugged_in.board.flash.content) == before
    assert plugged_in.runs_program()


def test_another_projector_is_left_alone(plugged_in, file):
    result = _run(file, "--yes", "--serial", "other")
    assert isinstance(result.exception, DisconnectedError)
    assert plugged_in.board.messages == []


def test_the_makers_file_is_refused_before_anything_is_sent(plugged_in, tmp_path):
    (tmp_path / "maker.bin").write_bytes(MAKER)
    result = _run(tmp_path / "maker.bin", "--yes")
    assert isinstance(result.exception, DataError)
    assert plugged_in.board.messages == []
