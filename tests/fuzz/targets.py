"""What is fuzzed: each target reads some bytes as a stranger's, and may raise nothing but a typed error."""

import json
import os
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.core.conventions import Lattice
from fpplab.core.errors import DataError, FppError
from tests.fuzz import seeds

Read = Callable[[bytes, Path], object]


@dataclass(frozen=True)
class Fuzzed:
    """A target: what reads the bytes, what it is told to begin with, and whose branches guide the search.

    What `loads` gives must be read without a refusal; what `odd` gives need not.
    """

    read: Read
    loads: Callable[[], list[bytes]]
    guided_by: tuple[str, ...]
    odd: Callable[[], list[bytes]] = list

    def seeds(self) -> list[bytes]:
        """All that it begins with."""
        return [*self.loads(), *self.odd()]

    def __call__(self, data: bytes, folder: Path) -> None:
        """Read bytes; `folder` is empty but for what earlier calls left."""
        with suppress(FppError):
            self.read(data, folder)


def write(folder: Path, name: str, content: bytes) -> Path:
    """A file with that content."""
    path = folder / name
    path.write_bytes(content)
    return path


def yaml(data: bytes, folder: Path) -> None:
    """The first byte says as which of the eight kinds the rest is read."""
    from fpplab.calibration.model import Calibration
    from fpplab.comparison.acceptance.standard import Standard
    from fpplab.devices.rig import Rig
    from fpplab.optimisation.study import Study
    from fpplab.patterns.plan import Plan
    from fpplab.targets.target import Target
    from sim.dataset.scenes import SceneRanges
    from sim.world.world import World

    kinds = (Calibration, SceneRanges, Plan, Rig, Standard, Study, Target, World)
    if data:
        kinds[data[0] % len(kinds)].load(write(folder, "some.yaml", data[1:]))


def calibration(data: bytes, folder: Path) -> None:
    from fpplab.calibration.model import Calibration

    Calibration.load(write(folder, "calibration.yaml", data))


def session(data: bytes, folder: Path) -> None:
    """A whole session with one of its files replaced; the first byte says which."""
    from fpplab.sessions.session import Session

    if not data:
        return
    files = seeds.session_files()
    names = sorted(files)
    place = folder / "session"
    (place / "frames").mkdir(parents=True, exist_ok=True)
    for name in names:
        write(place, name, files[name])
    write(place, names[data[0] % len(names)], data[1:])
    found = Session.open(place)
    assert len(found.missing()) <= found.plan.images
    with suppress(FppError):
        found.projector()
    with suppress(FppError):
        found.response()
    for record in found.records:
        found.read(record.index)


def cloud(data: bytes, folder: Path) -> None:
    from fpplab.clouds import CLOUD_SUFFIXES, load_cloud

    if data:
        suffix = CLOUD_SUFFIXES[data[0] % len(CLOUD_SUFFIXES)]
        len(load_cloud(write(folder, f"cloud{suffix}", data[1:])))


def decoded(data: bytes, folder: Path) -> None:
    from fpplab.phase.decoded import Decoded

    Decoded.load(write(folder, "decoded.npz", data))


def mesh(data: bytes, folder: Path) -> None:
    """As the process that reads meshes does; in it, exceptions of any kind are refusals."""
    from fpplab.core.foreign import read_mesh

    if data:
        try:
            parts = read_mesh(("stl", "ply", "obj")[data[0] % 3], data[1:])
        except Exception as error:
            raise DataError("refused") from error
        if not len(parts.get("faces", ())):
            raise DataError("it has no faces")


def opencv(data: bytes, folder: Path) -> None:
    """Its parser in a process forked from this one, as cheap as that can be."""
    from fpplab.calibration import dialects, interchange

    dialects.read_apart = _in_a_fork  # type: ignore[assignment]
    interchange.import_calibration([write(folder, "some.yml", data)], (640, 480), (912, 1140))


def dialect(data: bytes, folder: Path) -> None:
    """Calibrations of other programs; the first byte says by which suffix."""
    from fpplab.calibration import dialects, interchange

    dialects.read_apart = _in_a_fork  # type: ignore[assignment]
    if data:
        path = write(folder, f"some{seeds.DIALECTS[data[0] % len(seeds.DIALECTS)]}", data[1:])
        interchange.import_calibration([path], (1368, 912), (912, 1140), Lattice.DIAMOND)


def _in_a_fork(kind: str, path: Path) -> dict[str, Any]:
    """What `read_apart` gives, without starting Python anew."""
    import io

    import numpy as np

    from fpplab.core.foreign import CALIBRATIONS

    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            out = io.BytesIO()
            np.savez(out, **CALIBRATIONS[kind](path.read_bytes()))
            os.write(writing, out.getvalue()[:60_000])
        os._exit(0)
    os.close(writing)
    with open(reading, "rb") as stream:
        content = stream.read()
    os.waitpid(child, 0)
    try:
        with np.load(io.BytesIO(content)) as parts:
            return dict(parts)
    except Exception as error:
        raise ValueError("its reader fails on it") from error


def image(data: bytes, folder: Path) -> None:
    from fpplab.sessions.image_files import grey_images, places_in

    for _ in grey_images(places_in(write(folder, "image", data))[:4]):
        pass


def records(data: bytes, folder: Path) -> None:
    """Lines and objects of JSON; the first byte says of what."""
    from fpplab.core.checksums import check_recorded
    from fpplab.sessions.journal import read_journal
    from sim.dataset.card import read_card
    from sim.dataset.shard import check_shard
    from sim.matching.record import MatchingRecord
    from tests.support.recorded import PLAN

    if not data:
        return
    kind, text = data[0] % 5, data[1:]
    if kind == 0:
        write(folder, "journal.jsonl", text)
        read_journal(folder, PLAN)
    elif kind == 1:
        write(folder, "files.jsonl", text)
        check_recorded(folder / "plan.yaml", seeds.session_files()["plan.yaml"])
    elif kind == 2:
        write(folder, "card.json", text)
        read_card(folder)
    elif kind == 3:
        write(folder, "sha256.json", text)
        check_shard(folder)
    else:
        write(folder, "match.jsonl", text)
        MatchingRecord(folder).read()


def hid(data: bytes, folder: Path) -> None:
    """The emulated board is sent anything, and the driver is answered anything."""
    from drivers.clock import SteppedClock
    from drivers.dlp4500.transport import Link
    from drivers.emulators.dlpc350 import Dlpc350, Dlpc350Policy, EmulatedHid
    from drivers.emulators.dlpc350.usb import UnpluggedError
    from fpplab.core.errors import DeviceError
    from tests.drivers.dlp4500.test_fuzz import SHORT_COMMANDS
    from tests.drivers.dlpc350_host import FLASH

    reports = [data[k : k + 64].ljust(64, b"\0") for k in range(0, min(len(data), 640), 64)]
    clock = SteppedClock()
    wire = EmulatedHid(Dlpc350(clock, FLASH, Dlpc350Policy())).device()
    wire.open_path(b"emulated:0")
    for report in reports:
        try:
            if wire.write(b"\0" + report) == 65:
                wire.read(64, 1)
        except UnpluggedError:  # it was told to reset
            break
    answering = _Answers(clock, reports)
    link = Link(answering, clock, "projector")
    for command in (SHORT_COMMANDS[byte % len(SHORT_COMMANDS)] for byte in data[:4]):
        with suppress(DeviceError):
            if command.returned is not None:
                link.read(command)
            elif command.written is not None:
                link.write(command, **{f.name: f.values()[0] for f in command.written.named})


class _Answers:
    """A wire that answers with the fuzzer's reports, every other with the flags that were asked for."""

    def __init__(self, clock: Any, reports: list[bytes]) -> None:
        self._clock, self._reports, self._head = clock, list(reports), b""

    def write(self, buff: bytes) -> int:
        self._head = bytes(buff[1:3])
        return len(buff)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        if not self._reports:
            self._clock.sleep(timeout_ms / 1000)
            return []
        report = self._reports.pop(0)
        return list(self._head + report[2:] if report[0] & 1 else report)[:max_length]

    def close(self) -> None: ...


def grbl(data: bytes, folder: Path) -> None:
    """The emulated stage is sent anything, and each line of anything is parsed as an answer."""
    from drivers.emulators.grbl import GrblController
    from drivers.stage_grbl.lines import parse_line

    now = [0.0]
    controller = GrblController(lambda: now[0])
    for k in range(0, min(len(data), 512), 16):
        controller.receive(data[k : k + 16])
        now[0] += 0.05
        controller.poll()
    for line in data.decode("latin-1").split("\n")[:50]:
        with suppress(ValueError):
            parse_line(line)


def firmware(data: bytes, folder: Path) -> None:
    """A flash file with bytes changed: pairs of a place and a value."""
    from drivers.dlp4500.flash.firmware import Firmware

    content = bytearray(seeds.firmware())
    for k in range(0, len(data) - 4, 5):
        place, value = struct.unpack_from("<IB", data, k)
        content[place % len(content)] = value
    if data and data[0] == 255:
        content = content[: len(content) * data[-1] // 255]
    found = Firmware.load(write(folder, "some.bin", bytes(content)))
    assert found.images >= 0
    assert found.behind_program > 0


def line_of(value: Any) -> bytes:
    """One line of JSON."""
    return json.dumps(value).encode() + b"\n"


TARGETS: dict[str, Fuzzed] = {
    "yaml": Fuzzed(
        yaml,
        seeds.yaml,
        ("fpplab.core.config", "fpplab.core.strict_yaml", "yaml", "fpplab.devices.rig"),
        odd=seeds.odd_yaml,
    ),
    "calibration": Fuzzed(
        calibration, seeds.calibration, ("fpplab.calibration", "fpplab.core.strict_yaml", "yaml")
    ),
    "session": Fuzzed(
        session,
        seeds.session,
        ("fpplab.sessions", "fpplab.core.checksums", "fpplab.core.journals", "tifffile"),
    ),
    "cloud": Fuzzed(cloud, seeds.cloud, ("fpplab.clouds.ply", "fpplab.core.archives", "zipfile")),
    "decoded": Fuzzed(decoded, seeds.decoded, ("fpplab.core.archives", "zipfile", "numpy.lib.format")),
    "mesh": Fuzzed(mesh, seeds.mesh, ("trimesh.exchange",)),
    "opencv": Fuzzed(opencv, seeds.opencv, ("fpplab.calibration",)),
    "dialect": Fuzzed(dialect, seeds.dialect, ("fpplab.calibration", "yaml"), odd=seeds.odd_dialects),
    "image": Fuzzed(
        image,
        seeds.image,
        ("fpplab.sessions.image_files", "fpplab.sessions.image_files", "PIL", "fpplab.core.archives"),
    ),
    "records": Fuzzed(
        records,
        seeds.records,
        ("fpplab.core.checksums", "fpplab.core.journals", "fpplab.sessions.journal", "sim.dataset.card"),
        odd=seeds.odd_records,
    ),
    "hid": Fuzzed(hid, seeds.hid, ("drivers.dlp4500", "drivers.emulators.dlpc350")),
    "grbl": Fuzzed(grbl, seeds.grbl, ("drivers.stage_grbl", "drivers.emulators.grbl")),
    "firmware": Fuzzed(
        firmware, seeds.unchanged_firmware, ("drivers.dlp4500.flash",), odd=seeds.firmware_changes
    ),
}
