"""The real drivers on an emulated bench whose optics are the reference rig, and the images expected there."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.dlp4500.flash.firmware import Firmware, arrange_patterns
from drivers.dlp4500.index import FlashIndex
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.bench import EmulatedBench, EmulatedFixture
from fpplab.acquisition.acquire import expose
from fpplab.core import config
from fpplab.core.conventions import Image, Lattice
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from tests.conformance.reference import CAMERA_SIZE, PROJECTOR_SIZE
from tests.drivers.flash_files import maker_firmware

FULL = {"red": 255, "green": 255, "blue": 255}
PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4), Sinusoid(axis="y", stripes=1, steps=4)))
"""Eight patterns in three images, all different."""
REFERENCE = Path(__file__).parents[1] / "conformance" / "rigs" / "rig_reference.yaml"


def patterns() -> tuple[Pattern, ...]:
    return make_patterns(PLAN, SIZE, Lattice.DIAMOND)


def burn(folder: Path, held: Sequence[Pattern] | None = None) -> None:
    """Write patterns as firmware and index, by default those of the plan."""
    held = held or patterns()
    base = folder / "base.bin"
    base.write_bytes(maker_firmware())
    (folder / "patterns.bin").write_bytes(Firmware.load(base).with_patterns(held, base).content)
    index = FlashIndex.of(held, arrange_patterns(held))
    (folder / "patterns.yaml").write_text(config.dump(index), encoding="utf-8")


def rig_file(
    folder: Path,
    bench: dict[str, Any] | None = None,
    camera: dict[str, Any] | None = None,
    projector: dict[str, Any] | None = None,
) -> Rig:
    """Make the rig, not open yet; the sections hold what differs from the default."""
    own = "drivers.emulators.bench:"
    sections = {
        "bench": {"backend": own + "EmulatedBench", "optics": str(REFERENCE), "firmware": "patterns.bin"},
        "camera": {
            "backend": "drivers.basler:BaslerCamera",
            "serial": "0815-0000",
            "bits": 12,
            "roi": [0, 0, *CAMERA_SIZE],
        },
        "projector": {
            "backend": "drivers.dlp4500:Dlp4500",
            "flash": "patterns.yaml",
            "led_levels": FULL,
        },
        "stage": {"backend": "drivers.stage_grbl:GrblStage"},
        "fixture": {"backend": own + "EmulatedFixture"},
    }
    for name, other in (("bench", bench), ("camera", camera), ("projector", projector)):
        sections[name] |= other or {}
    file = config.validate({"name": "emulated", **sections}, RigFile, "rig")
    return Rig(file, folder, "rig.yaml")


def on_video(folder: Path, bench: dict[str, Any] | None = None, camera: dict[str, Any] | None = None) -> Rig:
    """Make the rig with its patterns from the video port, not open yet."""
    video = {"flash": None, "video": {"display": 0}}
    return rig_file(folder, {"firmware": None, **(bench or {})}, camera, video)


def bench_of(rig: Rig) -> EmulatedBench:
    """Return the emulated bench of a rig."""
    assert isinstance(rig.fixture, EmulatedFixture)
    return rig.fixture.bench


def taken(rig: Rig, plan: Plan = PLAN, shown: Sequence[Pattern] | None = None) -> Iterator[Image]:
    """Capture the frames of a plan."""
    for frame in expose(rig, shown or patterns(), rig.camera_settings(plan.exposure_s), plan):
        yield frame.image


@contextmanager
def reference() -> Iterator[Rig]:
    """Make the rig of the optics by itself."""
    with Rig.load(REFERENCE) as rig:
        yield rig


def seen(
    rig: Rig, image: np.ndarray[Any, Any] | None, bits: int = 12, exposure_s: float = PLAN.exposure_s
) -> Image:
    """Capture an image of grey levels with the optics alone, or of darkness."""
    if image is None:
        rig.projector.blank()
    else:
        (columns, rows), (width, height) = PROJECTOR_SIZE, SIZE
        places = np.ix_(np.arange(rows) * height // rows, np.arange(columns) * width // columns)
        rig.projector.load([Pattern("seen", np.asarray(image, np.uint8)[places])])
        rig.projector.show(0)
    rig.camera.configure(CameraSettings(exposure_s, 0.0, bits))
    return rig.camera.snap().image
