"""A virtual scene in front of a display projector and a video camera, as files that whole commands take."""

from pathlib import Path
from typing import Any

from fpplab.core import config
from sim.world import World

DISPLAY_PX, CAMERA_PX = (320, 200), (384, 256)
DEVICE = "/dev/video0"
"""Of the camera, in front of which the bench stands."""
BOARD = {
    "kind": "circles",
    "size_mm": [102, 71.4],
    "counts": [13, 4],
    "spacing_mm": [7.65, 15.3],
    "staggered": True,
    "diameter_mm": 5.1,
    "foreground": 0.05,
    "background": 0.9,
}
WORLD = {
    "seed": 11,
    "camera": {
        "sensor_size": list(CAMERA_PX),
        "binning": 1,
        "pixel_um": 34.2,
        "focal_mm": 35.0,
        "distortion": [-0.05, 0.08, 0.0, 0.0, 0.0],
    },
    "projector": {
        "size": list(DISPLAY_PX),
        "lattice": "square",
        "throw_ratio": 1.8,
        "centre_px": [158.0, 103.0],
        "T_camera_projector": {"rotation_deg": [0.0, -14.0, 0.0], "translation_mm": [110.0, 0.0, 0.0]},
        "leds": {"green": {"lumens": 0.13, "wavelength_nm": 525}},
    },
    "items": {
        "board": {
            "target": "board.yaml",
            "poses": {"count": 12, "tilt_deg": 25, "distance_mm": 450, "range_mm": 30},
        },
        "grey_card": {
            "card_mm": [400.0, 300.0],
            "pose": {"rotation_deg": [8.0, -12.0, 0.0], "translation_mm": [0.0, 0.0, 455.0]},
        },
    },
    "mounted": "grey_card",
}
PLANS: dict[str, Any] = {
    "plan_card.yaml": [("x", 1, 6), ("x", 8, 6), ("x", 32, 8)],
    "plan_board.yaml": [(axis, *part) for axis in "xy" for part in ((1, 4), (6, 4), (24, 6))],
}
"""Axis, stripes and steps of each set, by file."""


def write_scene(folder: Path) -> World:
    """Write plans, target and two rigs: `optics.yaml` is the scene, `rig.yaml` what looks at it."""
    own = "sim.devices:"
    documents: dict[str, Any] = {
        "board.yaml": BOARD,
        "world.yaml": WORLD,
        "optics.yaml": {
            "name": "Optics",
            "bench": {"backend": own + "VirtualBench", "world": "world.yaml", "analytic": True},
            "camera": {"backend": own + "SimCamera"},
            "projector": {"backend": own + "SimProjector"},
            "fixture": {"backend": own + "SimFixture"},
        },
        "rig.yaml": {
            "name": "A display projector and a video camera",
            "bench": {
                "backend": "tests.drivers.x_screen:ScreenAndVideoBench",
                "size": list(DISPLAY_PX),
                "optics": "optics.yaml",
            },
            "camera": {
                "backend": "drivers.video_camera:VideoCamera",
                "device": DEVICE,
                "bits": 12,
                "shutter": "global",
            },
            "projector": {
                "backend": "drivers.display:DisplayProjector",
                "display": 0,
                "size": list(DISPLAY_PX),
            },
            "fixture": {"backend": "tests.drivers.x_screen:XScreenFixture"},
        },
    }
    for name, sets in PLANS.items():
        fringes = [{"axis": axis, "stripes": stripes, "steps": steps} for axis, stripes, steps in sets]
        documents[name] = {"fringes": fringes, "exposure_s": 0.033}
    for name, document in documents.items():
        (folder / name).write_text(config.to_yaml(document), encoding="utf-8")
    return World.load(folder / "world.yaml")
