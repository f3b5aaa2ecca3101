"""Small simulated rigs, without Blender, for tests of the set-up."""

from pathlib import Path
from queue import SimpleQueue
from typing import Any

from fpplab.core import config
from fpplab.core.conventions import Mask
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.devices.rig_lock import watching_rig
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.setup.live.loop import LiveOptions, LiveSetUp
from fpplab.setup.live.orders import Order
from fpplab.setup.live.status import LiveStatus

CARD = {"card_mm": [400.0, 300.0], "pose": {"rotation_deg": [0, 0, 0], "translation_mm": [0, 0, 450]}}
TARGET = {
    "kind": "checkerboard", "size_mm": [140, 100], "counts": [8, 5], "spacing_mm": [14, 14],
}  # fmt: skip


def world(**changes: dict[str, Any]) -> dict[str, Any]:
    """A world of 228 x 152 pixels; `changes` are merged into its sections."""
    made: dict[str, Any] = {
        "seed": 5,
        "camera": {"sensor_size": [912, 608], "pixel_um": 14.4, "binning": 4, "focal_mm": 35.0},
        "projector": {
            "size": [228, 142],
            "lattice": "square",
            "throw_ratio": 1.2,
            "centre_px": [113.5, 70.5],
            "T_camera_projector": {"rotation_deg": [0, -18, 0], "translation_mm": [150, 0, 0]},
            "leds": {"green": {"lumens": 4.0, "wavelength_nm": 525}},
        },
        "items": {"card": CARD},
        "mounted": "card",
        "material": {"reflectance": 0.8},
    }
    for section, values in changes.items():
        made[section] = {**made.get(section, {}), **values} if isinstance(values, dict) else values
    return made


def rig_file(folder: Path, **changes: Any) -> Path:
    """A rig file on such a world."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "board.yaml").write_text(config.to_yaml(TARGET), encoding="utf-8")
    (folder / "world_small.yaml").write_text(config.to_yaml(world(**changes)), encoding="utf-8")
    rig = {
        "name": "Small bench",
        "bench": {"backend": "sim.devices:VirtualBench", "world": "world_small.yaml", "analytic": True},
        "camera": {"backend": "sim.devices:SimCamera", "bits": 8},
        "projector": {"backend": "sim.devices:SimProjector"},
        "stage": {"backend": "sim.devices:SimStage"},
        "fixture": {"backend": "sim.devices:SimFixture"},
    }
    path = folder / "rig_small.yaml"
    path.write_text(config.to_yaml(rig), encoding="utf-8")
    return path


PLAN = config.validate(
    {"fringes": [{"axis": "x", "stripes": 2, "steps": 4}, {"axis": "x", "stripes": 38, "steps": 4}],
     "exposure_s": 0.02},
    Plan, "plan.yaml",
)  # fmt: skip


class Operator:
    """Gives orders, each once the one before has been measured, and keeps what was shown."""

    def __init__(self, *orders: Order, after: int = 8) -> None:
        self.orders: SimpleQueue[Order] = SimpleQueue()
        self._left, self._after, self._waited = list(orders), after, 0
        self.seen: list[LiveStatus] = []
        self.frames: list[Frame] = []
        self.patterns: list[Pattern | None] = []

    def __call__(
        self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
    ) -> bool:
        self.seen.append(status)
        if frame is not None:
            self.frames.append(frame)
            self.patterns.append(pattern)
        self._waited += not status.message.endswith("is taken")  # a pose is being looked at
        if self._waited >= self._after and self._left:
            self.orders.put(self._left.pop(0))
            self._waited = 0
        return True


def operate(path: Path, operator: Operator, **options: Any) -> LiveSetUp:
    """Run the set-up with this operator until it quits."""
    setup = LiveSetUp(Rig.load(path), LiveOptions(**{"plan": PLAN, **options}), operator.orders, operator)
    with watching_rig(path) as turn:
        setup.run(turn)
    return setup
