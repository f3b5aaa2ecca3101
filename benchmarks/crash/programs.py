"""The commands that are disturbed, small enough to be run hundreds of times, and what they need."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

import tifffile

from benchmarks.crash.bench import NOTE
from drivers.dlp4500.flash.firmware import Firmware
from drivers.emulators.dlpc350.flash import SIZE
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_poses
from fpplab.sessions.session import Session
from sim.world import World
from tests.drivers.flash_files import maker_firmware
from tests.support.ready_program import ReadyProgram

ROOT = Path(__file__).parents[2]
LONGEST_S = 600.0
"""No command takes longer."""
SETS = [{"axis": axis, "stripes": stripes, "steps": 4} for axis in ("x", "y") for stripes in (1, 8, 48)]
SIM = {
    "camera": {"backend": "sim.devices:SimCamera", "bits": 8},
    "projector": {"backend": "sim.devices:SimProjector"},
    "fixture": {"backend": "sim.devices:SimFixture"},
}
VIRTUAL = {"backend": "sim.devices:VirtualBench", "world": "world.yaml", "analytic": True}
EMULATED = {
    "bench": {"backend": "benchmarks.crash.bench:WitnessedBench", "optics": "rig.yaml", "refresh_hz": 50},
    "camera": {"backend": "drivers.basler:BaslerCamera", "serial": "0815-0000", "roi": [0, 0, 342, 228]},
    "projector": {
        "backend": "drivers.dlp4500:Dlp4500",
        "video": {"display": 0},
        "led_levels": {"red": 255, "green": 255, "blue": 255},
    },
    "fixture": {"backend": "drivers.emulators.bench:EmulatedFixture"},
}
STUDY = {
    "name": "Small",
    "artefacts": ["pyramid"],
    "start": {"fringes": [{"axis": "x", "stripes": s, "steps": 3} for s in (1, 6, 24)]},
    "space": {"stripes": [None, None, [16, 64]]},
    "objectives": ["surface_smcd_um"],
    "seeds": [1, 2],
    "method": {"kind": "coordinate", "first": 0.5, "finest": 0.25},
    "budget": 3,
}


@dataclass(frozen=True)
class DisturbedProgram:
    """A command that leaves something."""

    name: str  # of the command
    words: str  # what follows the interpreter; `{out}` is its output
    share: int  # how often it is disturbed, in comparison with the others
    suffix: str = ""  # of its output
    opens_bench: bool = False  # whether it works on the emulated bench
    begin: Callable[[Path, Path], object] | None = None  # makes what its output is at first


def _new_flash(folder: Path, flash: Path) -> None:
    flash.write_bytes((folder / "maker.bin").read_bytes().ljust(SIZE, b"\xff"))


MEASURE = "--plan plan.yaml --calibration calibration.yaml --item board --out {out} --json"
POSES = "--plan plan.yaml --target target_paper --poses 3 --out {out} --json"
SCAN = DisturbedProgram("scan", f"-m fpplab scan --rig rig.yaml {MEASURE}", 10)
SCAN_EMULATED = DisturbedProgram(
    "scan on the emulated bench", f"-m fpplab scan --rig rig_emulated.yaml {MEASURE}", 8, opens_bench=True
)
IMPORT = DisturbedProgram(
    "import",
    "-m fpplab import images --plan plan.yaml --projector-size 912 1140 --lattice diamond "
    "--frames {{index:02d}}.tif --out {out} --json",
    8,
)
CHARACTERISE = DisturbedProgram(
    "characterise", f"-m fpplab characterise --rig rig_emulated.yaml {POSES}", 6, ".yaml", opens_bench=True
)
DATASET = DisturbedProgram(
    "dataset",
    "-m fpplab dataset --rig rig.yaml --plan plan.yaml --scenes ranges.yaml --count 3 --shard-size 1 "
    "--out {out} --json",
    4,
)
UPLOAD = DisturbedProgram(
    "upload",
    "-P board.py maker.bin {out} dlp4500 upload built.bin --yes --json",
    6,
    ".bin",
    begin=_new_flash,
)
MATCH = DisturbedProgram(
    "match", "-m fpplab match --twin rig.yaml --reference poses --epochs 3 --out {out} --json", 2
)
OPTIMISE = DisturbedProgram(
    "optimise",
    "-m fpplab optimise stripes --rig rig_artefacts.yaml --study study.yaml --calibration calibration.yaml "
    "--workers 1 --out {out} --json",
    2,
    ".yaml",
)
PROGRAMS = (SCAN, SCAN_EMULATED, IMPORT, CHARACTERISE, DATASET, UPLOAD, MATCH, OPTIMISE)
"""All of them."""


def prepare(folder: Path, programs: tuple[DisturbedProgram, ...]) -> None:
    """Write what the commands need."""
    world = _world()
    plan = config.validate({"fringes": SETS, "exposure_s": 0.02}, Plan, "plan")
    files: dict[str, Any] = {
        "world.yaml": world.model_dump(mode="json"),
        "rig.yaml": {"name": "Small twin", "bench": VIRTUAL, **SIM},
        "rig_artefacts.yaml": {"name": "Twin", "bench": {**VIRTUAL, "analytic": False}, **SIM},
        "rig_emulated.yaml": {"name": "Small emulated bench", **EMULATED},
        "plan.yaml": config.plain(plan),
        "study.yaml": STUDY,
        "ranges.yaml": _ranges(),
    }
    for name, data in files.items():
        (folder / name).write_text(config.to_yaml(data), encoding="utf-8")
    known = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    known.save(folder / "calibration.yaml")
    if {IMPORT, MATCH} & set(programs):
        with Rig.load(folder / "rig.yaml") as rig:
            poses = take_poses(rig, plan, "board", 3, folder / "poses", replace_existing=False)
        _write_images(poses[0], folder / "images")
    if UPLOAD in programs:
        shutil.copy(Path(__file__).with_name("board.py"), folder)
        (folder / "maker.bin").write_bytes(maker_firmware())
        patterns = uniform_patterns(list(range(100, 109)), (912, 1140))
        built = Firmware.load(folder / "maker.bin").with_patterns(patterns, folder / "built.bin")
        (folder / "built.bin").write_bytes(built.content)


def _world() -> World:
    """The demonstration's world with pixels four times as wide."""
    found = config.find_config("world_demo.yaml")
    data = config.parse_yaml(config.read_text(found), found)
    data["camera"] |= {"sensor_size": [1368, 912], "pixel_um": 9.6, "centre_offset_px": [3.5, -2.25]}
    data["projector"]["leds"] = {"green": {"lumens": 7.5, "wavelength_nm": 525}}
    return config.validate(data, World, "world")


def _ranges() -> dict[str, Any]:
    """Scenes that need no Blender."""
    found = config.find_config("dataset_demo.yaml")
    data = config.parse_yaml(config.read_text(found), found)
    return {**data, "artefacts": [], "stage_mm": [0, 0], "licence": "CC0-1.0"}


def _write_images(session: Session, folder: Path) -> None:
    folder.mkdir()
    for index, image in enumerate(session.stack()):
        tifffile.imwrite(folder / f"{index:02d}.tif", image)


@dataclass(frozen=True)
class EndedRun:
    """How a run ended."""

    code: int  # exit code, or minus the signal
    out: str  # what it wrote
    err: str  # what it wrote
    disturbed: bool = False  # whether the signal came while it ran
    seconds: float = 0.0  # how long it ran
    after_s: float = 0.0  # how long it ran on after the signal

    @property
    def is_done(self) -> bool:
        """Whether the work is done, now or by an earlier run."""
        return self.code == 0 or (self.code == 2 and "exists already" in self.err)


def start(
    program: DisturbedProgram, folder: Path, out: Path, *more: str, note: Path | None = None
) -> subprocess.Popen[str]:
    """Start a command in a session of processes of its own."""
    return subprocess.Popen(
        [sys.executable, *program.words.format(out=out.relative_to(folder)).split(), *more],
        cwd=folder,
        env=_environment(note or note_of(out)),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def _environment(note: Path) -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "PYTHONFAULTHANDLER": "1",
        "FPPLAB_ALLOW_BACKEND": "benchmarks.crash.bench",
        "FPPLAB_TRACEBACK": "1",
        NOTE: str(note),
    }


def place_of(folder: Path, program: DisturbedProgram, name: str) -> Path:
    """Name an output of a command, begun as the command wants it."""
    out = folder / f"{program.name.replace(' ', '_')}_{name}{program.suffix}"
    if program.begin:
        program.begin(folder, out)
    return out


def note_of(out: Path) -> Path:
    """Name the file in which the bench notes how it was left."""
    return out.parent / "notes" / f"{out.stem}.json"


def run_until(
    program: DisturbedProgram, folder: Path, out: Path, moment_s: float | None = None, number: int = 0
) -> EndedRun:
    """Run a command to its end, or until a moment at which it gets a signal."""
    note_of(out).parent.mkdir(exist_ok=True)
    begun = signalled = time.monotonic()
    process = start(program, folder, out)
    disturbed = False
    if moment_s is not None:
        try:
            process.wait(moment_s)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
            disturbed, signalled = True, time.monotonic()
    words, said = process.communicate()
    end = time.monotonic()
    return EndedRun(process.returncode, words, said, disturbed, end - begun, end - signalled)


def run_until_killed(
    ready: ReadyProgram, program: DisturbedProgram, folder: Path, out: Path, moment_s: float | None = None
) -> EndedRun:
    """Run a command to its end, or kill it at a moment; where it is fpplab's own, its modules are loaded."""
    module, *words = program.words.format(out=out.relative_to(folder)).split()[1:]
    if module != "fpplab":
        return run_until(program, folder, out, moment_s, signal.SIGKILL)
    note_of(out).parent.mkdir(exist_ok=True)
    begun, timers = time.monotonic(), list[Timer]()

    def kill_later(process: int) -> None:
        if moment_s is not None:
            timers.append(Timer(moment_s, os.kill, (process, signal.SIGKILL)))
            timers[0].start()

    done = ready.run(words, folder, _environment(note_of(out)), LONGEST_S, kill_later)
    for timer in timers:
        timer.cancel()
        timer.join()
    seconds, killed = time.monotonic() - begun, done.returncode == -signal.SIGKILL
    return EndedRun(done.returncode, done.stdout, done.stderr, killed, seconds)
