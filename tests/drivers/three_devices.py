"""A display projector, a video camera and a stage before one virtual scene, each by its own driver.

What the projector shows is read from the screen of an X server, another rig makes a picture of it, and that
lights the sensor of the video camera. The scene is that of the whole commands, for few pixels, with a stage.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.display.window import SdlDisplay, VideoFrame
from drivers.emulators.grbl import GrblController
from drivers.emulators.grbl.drive import DEFAULTS, Rail
from drivers.emulators.terminal import PseudoTerminal
from drivers.video_camera.device import StampedFrame
from fpplab.acquisition.acquire import capture
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from sim.items import item_poses
from sim.world import World
from tests.conformance.grbl import TIMES_FASTER
from tests.conformance.video_end import ScriptedVideo
from tests.drivers.screen_scene import DISPLAY_PX, write_scene
from tests.drivers.x_screen import XScreenBench
from tests.vm.uvc_descriptors import HEIGHT, REFERENCE_EXPOSURE_S, WIDTH

PLAN = Plan(
    fringes=(Sinusoid(axis="x", stripes=1, steps=6), Sinusoid(axis="x", stripes=8, steps=6)), exposure_s=0.02
)
PLACES_MM = (0.0, 15.0)
"""Of the stage, which carries the projector."""
PULL_OFF_MM = DEFAULTS[27]
STEP_DIGITS = 4
POLL_S, PATIENCE_S = 0.01, 120.0
"""How often the screen is looked at, and for how long, until it shows what was drawn."""


class SeenDisplay(SdlDisplay):
    """Has the bench look at each frame once it is on the screen."""

    def __init__(self, bench: ThreeDevicesBench, size: tuple[int, int]) -> None:
        super().__init__("projector", 0, size)
        self._bench = bench

    def show(self, frame: VideoFrame, refreshes: int | None = None) -> None:
        super().show(frame, refreshes)
        if refreshes is None:
            self._bench.look(frame)


class ThreeDevicesBench(XScreenBench):
    """The three devices around the scene of `optics`; a subclass has the camera."""

    def __init__(self, options: dict[str, Any]) -> None:
        self._seen_px = tuple(options["size"])
        super().__init__(options)

    def open(self) -> None:
        super().open()
        try:
            self._open_devices()
        except BaseException:
            self.close()
            raise

    def _open_devices(self) -> None:
        self.display = SeenDisplay(self, self._seen_px)
        optical = self.optics_rig.stage
        travel_mm = (optical.caps.travel_mm[1] if optical else 50.0) + PULL_OFF_MM
        rail = Rail(length_mm=travel_mm + 5.0, start_mm=PULL_OFF_MM)
        self._grbl = GrblController(lambda: TIMES_FASTER * time.monotonic(), {130: travel_mm}, rail)
        self._terminal = self._stack.enter_context(PseudoTerminal(self._grbl))
        self.stage_port = self._terminal.port

    def light_sensor(self, share: Floats) -> None:
        """Light the camera's sensor: shares of full scale at the reference exposure."""
        raise NotImplementedError

    def look(self, frame: VideoFrame) -> None:
        """Light the camera's sensor with what is on the screen, where the stage stands.

        The server draws a little after it was told to, on an emulated processor much later.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while not np.array_equal(self.server.screen(), frame):
            assert time.monotonic() < deadline_s, "the server never drew the frame"
            time.sleep(POLL_S)
        with self._terminal.lock:
            carriage_mm = self._grbl.drive.carriage_mm
        self.optics.move_stage(round(carriage_mm - PULL_OFF_MM, STEP_DIGITS))
        settings = CameraSettings(REFERENCE_EXPOSURE_S, bits=12)
        light = np.rint(self.light()).astype(np.uint8)
        self.light_sensor(self.optics.capture(settings, light, lambda: ()) / 4095.0)


class LitVideo(ScriptedVideo):
    """A video camera, in place of the kernel's, whose sensor is lit by hand."""

    light: Floats = np.zeros((HEIGHT, WIDTH))

    def read(self, timeout_s: float) -> StampedFrame | None:
        time.sleep(self.settings.exposure_s + 3 * self.frame_s)
        share = np.clip(self.light * self.settings.exposure_s / REFERENCE_EXPOSURE_S, 0.0, 1.0)
        return self._stamped(np.rint(4095 * share).astype(np.uint16), time.monotonic())


class WithoutKernelBench(ThreeDevicesBench):
    """The bench with a camera that needs no kernel."""

    def __init__(self, options: dict[str, Any]) -> None:
        super().__init__(options)
        self._video = LitVideo((WIDTH, HEIGHT))

    def video(self, path: str) -> LitVideo:
        """The camera, whatever its path."""
        return self._video

    def light_sensor(self, share: Floats) -> None:
        self._video.light = share


def write_three(folder: Path, bench: str, device: str) -> World:
    """Write the scene and `rig.yaml`, with the bench and the camera's device file."""
    write_scene(folder)
    world = config.parse_yaml((folder / "world.yaml").read_text(), "world")
    world["camera"] |= {"sensor_size": [WIDTH, HEIGHT], "pixel_um": 273.6}
    world["projector"]["leds"]["green"]["lumens"] = 0.004
    del world["items"]["board"]
    world["stage"] = {"travel_mm": [0, 40], "axis": [1, 0, 0]}
    optics = config.parse_yaml((folder / "optics.yaml").read_text(), "optics")
    optics["camera"]["bits"] = 12
    del optics["fixture"]
    optics["stage"] = {"backend": "sim.devices:SimStage"}
    size = list(DISPLAY_PX)
    rig = {
        "name": "A display projector, a video camera and a stage by their own drivers",
        "bench": {"backend": bench, "size": size, "optics": "optics.yaml", "curve": "srgb"},
        "camera": {"backend": "drivers.video_camera:VideoCamera", "device": device, "bits": 12},
        "projector": {
            "backend": "drivers.display:DisplayProjector",
            "display": 0,
            "size": size,
            "curve": "srgb",
        },
        "stage": {"backend": "drivers.stage_grbl:GrblStage"},
    }
    for name, document in (("world", world), ("optics", optics), ("rig", rig)):
        (folder / f"{name}.yaml").write_text(config.to_yaml(document), encoding="utf-8")
    return World.load(folder / "world.yaml")


def rms_mm(frames: list[np.ndarray], world: World, stage_mm: float) -> float:
    """Distance of the points from the card that is really there."""
    recording = Recording(frames, PLAN, world.projector.size, 12, "scene")
    place = world.T_projector_camera(stage_mm)
    true = Calibration(world.camera_model(), world.projector_model(), place, {})
    _, cloud = points_of(decode(recording), true, PLAN)
    assert len(cloud.points) > 0.8 * WIDTH * HEIGHT
    pose = item_poses(world, "grey_card")[0]
    return float(np.sqrt(np.mean(((cloud.points - pose.translation) @ pose.rotation[:, 2]) ** 2)))


def check_card(folder: Path, bench: str, device: str) -> None:
    """Measure the card from two places of the stage: it is where it is, and only for the true place."""
    world = write_three(folder, bench, device)
    with Rig.load(folder / "rig.yaml") as rig:
        assert rig.stage is not None
        rig.stage.home()
        for place_mm in PLACES_MM:
            assert abs(rig.stage.move_to(place_mm) - place_mm) < 0.01
            frames = capture(rig, PLAN)
            errors = {other: rms_mm(frames, world, other) for other in PLACES_MM}
            print(f"stage at {place_mm:g} mm: RMS from the true card {errors[place_mm]:.3f} mm")
            assert errors[place_mm] < 0.5
            assert all(error > 5.0 for other, error in errors.items() if other != place_mm)
