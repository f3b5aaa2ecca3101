"""Faults in the driver of displays, in measuring their times, in finding devices and writing rig files."""

from __future__ import annotations

from tests.conformance.fault import Fault

SCREEN, WINDOW, DEVICE, CURVE = (
    f"drivers/display/{name}.py" for name in ("screen", "window", "device", "curve")
)
FLASHING = "fpplab/devices/flashing.py"
TIMES, SET_UP = "fpplab/setup/display_timing.py", "fpplab/setup/new_rig.py"
OF_COMPUTER, DISCOVERY = "drivers/computer_discovery.py", "drivers/discovery.py"

DISPLAYS = [
    Fault(
        "display: any will do",
        SCREEN,
        "_chosen",
        "[display for display in displays if wanted in (display.index, display.name)]",
        "displays[:1]",
    ),
    Fault(
        "display: of two with one name the first",
        SCREEN,
        "_chosen",
        "if len(found) > 1:",
        "if len(found) > 2:",
    ),
    Fault(
        "display: what is drawn is not read back",
        SCREEN,
        "Screen.show",
        "if self._read_back() != frame:",
        "if not frame:",
    ),
    Fault(
        "display: a flash stays",
        SCREEN,
        "Screen.show",
        "for _ in range(refreshes):\n    self._present()\nself._upload(black)",
        "for _ in range(refreshes):\n    self._present()",
    ),
    Fault(
        "display: a frame of any shape",
        WINDOW,
        "SdlDisplay.show",
        "if frame.shape != self._shape or frame.dtype != np.uint8:",
        "if frame.dtype != np.uint8:",
    ),
    Fault(
        "display: a flash is a frame",
        WINDOW,
        "SdlDisplay.show",
        "self._connection.send(ShowFrame(refreshes))",
        "self._connection.send(ShowFrame(None))",
    ),
    Fault(
        "display: the curve the wrong way",
        CURVE,
        "pixel_table",
        "srgb_values(greys) if is_srgb else greys",
        "srgb_light(greys) if is_srgb else greys",
    ),
    Fault(
        "display: what is asked for counts as shown",
        DEVICE,
        "DisplayProjector._load",
        "replace(pattern, image=self._light[pixels])",
        "pattern",
    ),
    Fault("display: lit while it loads", DEVICE, "DisplayProjector._load", "self._blank()", ""),
    Fault(
        "display: fewer bits are eight",
        DEVICE,
        "DisplayProjector._load",
        "quantise(pattern.image / 255.0, pattern.bit_depth)",
        "quantise(pattern.image / 255.0, 8)",
    ),
    Fault(
        "display: every colour",
        DEVICE,
        "DisplayProjector._frame",
        "np.where(drawn, pixels[..., None], np.uint8(0))",
        "np.repeat(pixels[..., None], len(drawn), axis=2)",
    ),
    Fault(
        "display: light is always steady",
        DEVICE,
        "DisplayProjector._caps",
        "0.0 if self._options.steady else vsync_s",
        "0.0",
    ),
    Fault(
        "display: every lattice is square",
        DEVICE,
        "DisplayProjector._caps",
        "self._options.lattice",
        "Lattice.SQUARE",
    ),
    Fault("display: of any resolution", DEVICE, "DisplayProjector._setup", "chosen.size", "None"),
    Fault(
        "display: dark is grey",
        DEVICE,
        "DisplayProjector._blank",
        "np.zeros(...)",
        "np.full((height, width, 3), 16, np.uint8)",
    ),
    Fault(
        "display: as many refreshes as wanted",
        FLASHING,
        "FlashingProjector.flash",
        "if not 1 <= refreshes <= MAX_REFRESHES:",
        "if refreshes < 0:",
    ),
]

TIMING = [
    Fault(
        "timing: from dark to bright alone",
        TIMES,
        "_Levels._suffices",
        "((BLACK, GREY), (GREY, BLACK))",
        "((BLACK, GREY),)",
    ),
    Fault(
        "timing: saturated flashes count",
        TIMES,
        "_Levels",
        "if (lit >= self._full).mean() <= SATURATED or grey == GREYS[-1]:",
        "if grey == GREYS[0]:",
    ),
    Fault(
        "timing: one refresh too many",
        TIMES,
        "_Levels.refresh_s",
        "frame.result() * self._exposure_s / REFRESHES",
        "frame.result() * self._exposure_s / (REFRESHES + 1)",
    ),
    Fault(
        "timing: what the camera does not see",
        TIMES,
        "_Levels",
        "if not self._range >= LEAST_RISE * self._full:",
        "if self._range < -self._full:",
    ),
    Fault(
        "timing: every refresh agrees",
        TIMES,
        "DisplayTiming.agrees",
        "abs(self.refresh_s / self.told_s - 1.0) <= MOST_APART",
        "abs(self.refresh_s - self.told_s) >= 0.0",
    ),
    Fault(
        "timing: longer than the camera can",
        TIMES,
        "measure_display",
        "if exposure_s > rig.camera.caps.exposure_s[1]:",
        "if exposure_s > 1e3 * rig.camera.caps.exposure_s[1]:",
    ),
]

RIG_FILES = [
    Fault(
        "rig file: light that is not seen",
        SET_UP,
        "look_at_light",
        "if not rise >= LEAST_RISE:",
        "if rise < -1.0:",
    ),
    Fault(
        "rig file: what nobody named is taken",
        SET_UP,
        "RigSetup._chosen",
        "[d for d in all_of_kind if d.is_certain]",
        "all_of_kind",
    ),
    Fault("rig file: the first of several", SET_UP, "_only", "if len(chosen) == 1:", "if chosen:"),
    Fault(
        "rig file: a picture of nothing",
        SET_UP,
        "look_at_scene",
        "if image.min() == image.max():",
        "if image.size == 0:",
    ),
    Fault("rig file: the stage moves unasked", SET_UP, "RigSetup._stage", "if home:", "if stage:"),
    Fault(
        "rig file: over the one that is there",
        "fpplab/cli/commands/rig.py",
        "new_command",
        "refuse_existing(out, force)",
        "",
    ),
    Fault(
        "devices: the main display is a projector",
        OF_COMPUTER,
        "displays",
        'FoundDevice("projector", model, "", link, section, "rig_display.yaml", not one.is_main)',
        'FoundDevice("projector", model, "", link, section, "rig_display.yaml", True)',
    ),
    Fault(
        "devices: a camera's metadata is a camera",
        OF_COMPUTER,
        "video_cameras",
        'if _text(entry / "index") not in ("0", ""):',
        'if _text(entry / "index") == "":',
    ),
    Fault(
        "devices: folders without producers are silent",
        OF_COMPUTER,
        "producers",
        "if not files:",
        "if found is None:",
    ),
    Fault(
        "devices: the desktop is a video port",
        DISCOVERY,
        "_with_video_port",
        'd.is_certain and d.section.get("size") == size',
        'd.section.get("size") == size',
    ),
]
