"""Faults in the one interface that all backends share."""

from __future__ import annotations

from tests.conformance.fault import Fault

DEVICE = "fpplab/devices/device.py"
CAMERA_BASE = "fpplab/devices/camera.py"
PROJECTOR_BASE = "fpplab/devices/projector.py"
STAGE_BASE = "fpplab/devices/stage.py"
FIXTURE_BASE = "fpplab/devices/fixture.py"
REPLAY = "fpplab/sessions/replay.py"
REFERENCE = "tests/conformance/reference.py"

LIFE = [
    Fault(
        "a foreign exception is swallowed",
        DEVICE,
        "Device._guard",
        "raise DeviceError(...) from error",
        "return",
    ),
    Fault(
        "a foreign exception passes as it is",
        DEVICE,
        "Device._guard",
        "except Exception as error:",
        "except ZeroDivisionError as error:",
    ),
    Fault(
        "a fault does not last",
        DEVICE,
        "Device._fault",
        "self._state = State.FAULT",
        "self._state = State.IDLE",
    ),
    Fault(
        "closing twice is refused",
        DEVICE,
        "Device.close",
        "if self._state is State.CLOSED:\n    return",
        'self._need(State.IDLE, State.ARMED, State.FAULT, doing="close")',
    ),
    Fault(
        "a failed closing leaves it open",
        DEVICE,
        "Device.close",
        "try:\n    ...\nfinally:\n    self._state = State.CLOSED",
        'with self._guard("close"):\n    self._close()\nself._state = State.CLOSED',
    ),
    Fault(
        "a failed opening counts as one",
        DEVICE,
        "Device.open",
        "self._close_quietly()\nraise",
        "self._close_quietly()\nself._state = State.IDLE\nraise",
    ),
    Fault(
        "opening twice is accepted",
        DEVICE,
        "Device.open",
        "if self._state is not State.CLOSED:",
        "if self._state is State.FAULT:",
    ),
    Fault("what was known survives a closing", DEVICE, "Device.open", "self._forget()", ""),
]

CAMERA = [
    Fault(
        "exposures are in microseconds",
        REFERENCE,
        "ReferenceCamera._caps",
        "(1e-4, 1.0)",
        "(100.0, 1e6)",
    ),
    Fault(
        "a trigger has the name of its line",
        REFERENCE,
        "ReferenceCamera._caps",
        '("software", "hardware")',
        '("software", "hardware", "line1")',
    ),
    Fault(
        "unknown keys pass",
        REFERENCE,
        "ReferenceCamera._setup",
        "super()._setup(options, bench)",
        "",
    ),
    Fault(
        "every second picture comes twice",
        REFERENCE,
        "ReferenceCamera._read",
        "self._buffer[...] = self._levels(pattern)",
        "if self._count % 2 == 0:\n    self._buffer[...] = self._levels(pattern)",
    ),
    Fault(
        "the driver numbers the frames",
        REFERENCE,
        "ReferenceCamera._arrived",
        "self._bench.frames_to_lose -= 1\nself._count += 1",
        "self._bench.frames_to_lose -= 1",
    ),
    Fault(
        "the exposure is clamped",
        CAMERA_BASE,
        "Camera.configure",
        'self._within("exposure_s", settings.exposure_s, caps.exposure_s, "s")',
        "least, most = caps.exposure_s\n"
        "settings = replace(settings, exposure_s=min(max(settings.exposure_s, least), most))",
    ),
    Fault(
        "the gain is not checked",
        CAMERA_BASE,
        "Camera.configure",
        'self._within("gain_db", settings.gain_db, caps.gain_db, "dB")',
        "",
    ),
    Fault(
        "the bits are not checked",
        CAMERA_BASE,
        "Camera.configure",
        "if settings.bits not in caps.bits:",
        "if settings.bits > 16:",
    ),
    Fault(
        "settings are returned as asked for",
        CAMERA_BASE,
        "Camera.configure",
        "return back",
        "return settings",
    ),
    Fault(
        "armed after the last frame",
        CAMERA_BASE,
        "Camera.read",
        "if self._taken == self._awaited:",
        "if self._taken > self._awaited:",
    ),
    Fault("armed after a stop", CAMERA_BASE, "Camera.stop", "self._state = State.IDLE", ""),
    Fault(
        "arming while armed",
        CAMERA_BASE,
        "Camera.arm",
        'self._need(State.IDLE, doing="arm")',
        'self._need(State.IDLE, State.ARMED, doing="arm")',
    ),
    Fault(
        "a lost frame is not noticed",
        CAMERA_BASE,
        "Camera._checked",
        "if frame.index != self._taken:",
        "if frame.index < self._taken:",
    ),
    Fault(
        "a trigger that is not there",
        CAMERA_BASE,
        "Camera.arm",
        "if trigger not in self.caps.triggers:",
        "if not trigger:",
    ),
    Fault("a frame is dropped", REFERENCE, "ReferenceCamera._read", "self._count += 1", "self._count += 2"),
    Fault(
        "a frame is repeated",
        REFERENCE,
        "ReferenceCamera._read",
        "self._buffer[...] = self._levels(pattern)",
        "if not self._buffer.any():\n    self._buffer[...] = self._levels(pattern)",
    ),
    Fault(
        "frames share a buffer",
        REFERENCE,
        "ReferenceCamera._read",
        "self._buffer.copy()",
        "self._buffer",
    ),
    Fault(
        "a time-out is ignored",
        REFERENCE,
        "ReferenceCamera._exposed",
        "raise DeviceTimeoutError(...)",
        "return self._bench.on_show",
    ),
    Fault("12 bits hold 8", REFERENCE, "ReferenceCamera._levels", "(1 << settings.bits) - 1", "255"),
    Fault(
        "another clock than the host's",
        REFERENCE,
        "ReferenceCamera._read",
        "time.time()",
        "time.monotonic()",
    ),
]

PROJECTOR = [
    Fault(
        "one pattern too far",
        PROJECTOR_BASE,
        "Projector.show",
        "if not 0 <= i < len(self._loaded):",
        "if not 0 <= i <= len(self._loaded):",
    ),
    Fault(
        "patterns from the end",
        PROJECTOR_BASE,
        "Projector.show",
        "if not 0 <= i < len(self._loaded):",
        "if not i < len(self._loaded):",
    ),
    Fault(
        "patterns of any size",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8",
        "pattern.image.dtype != np.uint8",
    ),
    Fault(
        "patterns of any kind",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8",
        "pattern.image.shape != (height, width)",
    ),
    Fault(
        "patterns of any depth",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "if pattern.bit_depth not in caps.bit_depths:",
        "if not pattern.bit_depth:",
    ),
    Fault(
        "too many patterns",
        PROJECTOR_BASE,
        "Projector.load",
        "if not 1 <= len(patterns) <= caps.max_patterns:",
        "if not 1 <= len(patterns):",
    ),
    Fault(
        "half a load",
        PROJECTOR_BASE,
        "Projector.load",
        "self._check_pattern(pattern, caps)",
        "self._check_pattern(pattern, caps)\nself._loaded = (*self._loaded, pattern)",
    ),
    Fault(
        "patterns are not copied",
        PROJECTOR_BASE,
        "",
        "pattern.image.copy()",
        "pattern.image.view()",
    ),
    Fault(
        "playing without a trigger output",
        PROJECTOR_BASE,
        "Projector.play",
        "if not caps.trigger_outputs:",
        "if caps.trigger_outputs < 0:",
    ),
    Fault(
        "playing too fast",
        PROJECTOR_BASE,
        "Projector.play",
        "if not exposure_s >= least:",
        "if exposure_s < 0:",
    ),
    Fault("shown while it plays", PROJECTOR_BASE, "Projector.play", "self._state = State.ARMED", ""),
    Fault(
        "off by one",
        REFERENCE,
        "ReferenceProjector._show",
        "self._held[i]",
        "self._held[i - 1]",
    ),
    Fault(
        "blank is not dark",
        REFERENCE,
        "ReferenceProjector._blank",
        "self._bench.on_show = None",
        "self._bench.pulses.clear()",
    ),
    Fault(
        "closing is not dark",
        REFERENCE,
        "ReferenceProjector._close",
        "self._bench.on_show = None",
        "self._held = []",
    ),
    Fault(
        "not quantised",
        REFERENCE,
        "ReferenceProjector._load",
        "quantise(p.image / 255.0, p.bit_depth)",
        "p.image",
    ),
    Fault(
        "pattern ids are lost",
        REFERENCE,
        "ReferenceProjector._load",
        "replace(...)",
        'replace(p, id="", image=quantise(p.image / 255.0, p.bit_depth))',
    ),
    Fault(
        "a replayed frame is another's",
        REPLAY,
        "ReplayCamera._read",
        "self._recording.session.read(index)",
        "self._recording.session.read(max(index - 1, 0))",
    ),
    Fault(
        "a replayed pattern is another",
        REPLAY,
        "ReplayProjector._show",
        "self._indices[i]",
        "self._indices[i - 1]",
    ),
]

STAGE_AND_FIXTURE = [
    Fault(
        "moves without homing",
        STAGE_BASE,
        "Stage.move_to",
        "if not self._homed:",
        "if self._homed is None:",
    ),
    Fault(
        "moves are clamped",
        STAGE_BASE,
        "Stage._check_reach",
        "least, most = self.caps.travel_mm",
        "least, most = self.caps.travel_mm\nmm = min(max(mm, least), most)",
    ),
    Fault(
        "the position asked for is returned",
        STAGE_BASE,
        "Stage.move_to",
        "return self._position_mm()",
        "return mm",
    ),
    Fault("a halt keeps the reference", STAGE_BASE, "Stage.halt", "self._homed = False", ""),
    Fault(
        "any item",
        FIXTURE_BASE,
        "Fixture._check_held",
        "if items is not None and item not in items:",
        "if not item:",
    ),
    Fault(
        "one pose too many",
        FIXTURE_BASE,
        "Fixture._check_held",
        "pose >= poses",
        "pose > poses",
    ),
]
