"""Faults in the one interface that all backends share, in what uses it, and in the virtual bench."""

from __future__ import annotations

from tests.conformance.fault import Fault

DEVICE = "fpplab/devices/device.py"
CAMERA_BASE = "fpplab/devices/camera.py"
PROJECTOR_BASE = "fpplab/devices/projector.py"
STAGE_BASE = "fpplab/devices/stage.py"
FIXTURE_BASE = "fpplab/devices/fixture.py"
ACQUISITION = "fpplab/acquisition/acquire.py"
SYNCHRONISATION = "fpplab/acquisition/synchronisation.py"
MARKER = "fpplab/acquisition/sync_check.py"
RIG = "fpplab/devices/rig.py"
REPLAY = "fpplab/sessions/replay.py"
REFERENCE = "tests/conformance/reference.py"
SIM = "sim/devices.py"

LIFE = [
    Fault(
        "a foreign exception is swallowed",
        DEVICE,
        "            self._fault()\n            raise DeviceError(\n",
        "            self._fault()\n            return\n            raise DeviceError(\n",
    ),
    Fault(
        "a foreign exception passes as it is",
        DEVICE,
        "        except Exception as error:\n            self._fault()",
        "        except ZeroDivisionError as error:\n            self._fault()",
    ),
    Fault(
        "a fault does not last",
        DEVICE,
        "            self._state = State.FAULT\n",
        "            self._state = State.IDLE\n",
    ),
    Fault(
        "closing twice is refused",
        DEVICE,
        "        if self._state is State.CLOSED:\n            return\n",
        '        self._need(State.IDLE, State.ARMED, State.FAULT, doing="close")\n',
    ),
    Fault(
        "a failed closing leaves it open",
        DEVICE,
        "                self._close()\n        finally:\n",
        "                self._close()\n        except KeyError:\n            raise\n        else:\n",
    ),
    Fault(
        "a failed opening counts as one",
        DEVICE,
        "            self._close_quietly()\n            raise\n",
        "            self._close_quietly()\n            self._state = State.IDLE\n            raise\n",
    ),
    Fault(
        "opening twice is accepted",
        DEVICE,
        '        if self._state is not State.CLOSED:\n            raise StateError(self.name, "open"',
        '        if self._state is State.FAULT:\n            raise StateError(self.name, "open"',
    ),
    Fault("what was known survives a closing", DEVICE, "        self._forget()\n", ""),
]

CAMERA = [
    Fault(
        "the exposure is clamped",
        CAMERA_BASE,
        '        self._within("exposure_s", settings.exposure_s, caps.exposure_s, "s")\n',
        "        least, most = caps.exposure_s\n"
        "        settings = replace(settings, exposure_s=min(max(settings.exposure_s, least), most))\n",
    ),
    Fault(
        "the gain is not checked",
        CAMERA_BASE,
        '        self._within("gain_db", settings.gain_db, caps.gain_db, "dB")\n',
        "",
    ),
    Fault(
        "the bits are not checked",
        CAMERA_BASE,
        "if settings.bits not in caps.bits:",
        "if settings.bits > 16:",
    ),
    Fault(
        "settings are returned as asked for",
        CAMERA_BASE,
        "        return back\n\n    @final\n    def arm",
        "        return settings\n\n    @final\n    def arm",
    ),
    Fault(
        "armed after the last frame",
        CAMERA_BASE,
        "if self._taken == self._awaited:",
        "if self._taken > self._awaited:",
    ),
    Fault(
        "armed after a stop",
        CAMERA_BASE,
        "            self._stop()\n        self._state = State.IDLE\n",
        "            self._stop()\n",
    ),
    Fault(
        "arming while armed",
        CAMERA_BASE,
        '(State.IDLE, doing="arm")',
        '(State.IDLE, State.ARMED, doing="arm")',
    ),
    Fault(
        "a lost frame is not noticed",
        CAMERA_BASE,
        "if frame.index != self._taken:",
        "if frame.index < self._taken:",
    ),
    Fault(
        "a trigger that is not there", CAMERA_BASE, "if trigger not in self.caps.triggers:", "if not trigger:"
    ),
    Fault("a frame is dropped", REFERENCE, "self._count += 1", "self._count += 2"),
    Fault(
        "a frame is repeated",
        REFERENCE,
        "        self._buffer[...] = ",
        "        if not self._buffer.any():\n            self._buffer[...] = ",
    ),
    Fault("frames share a buffer", REFERENCE, "self._buffer.copy()", "self._buffer"),
    Fault(
        "a time-out is ignored",
        REFERENCE,
        '            raise DeviceTimeoutError(self.name, "read", "no trigger came", "see to the trigger cable")',
        "            return self._bench.on_show",
    ),
    Fault("12 bits hold 8", REFERENCE, "full = (1 << settings.bits) - 1", "full = 255"),
    Fault("another clock than the host's", REFERENCE, "time.time()", "time.monotonic()"),
]

PROJECTOR = [
    Fault(
        "one pattern too far",
        PROJECTOR_BASE,
        "if not 0 <= i < len(self._loaded):",
        "if not 0 <= i <= len(self._loaded):",
    ),
    Fault(
        "patterns from the end",
        PROJECTOR_BASE,
        "if not 0 <= i < len(self._loaded):",
        "if not i < len(self._loaded):",
    ),
    Fault(
        "patterns of any size",
        PROJECTOR_BASE,
        "if pattern.image.shape != (height, width) or",
        "if",
    ),
    Fault("patterns of any kind", PROJECTOR_BASE, " or pattern.image.dtype != np.uint8:", ":"),
    Fault(
        "patterns of any depth",
        PROJECTOR_BASE,
        "if pattern.bit_depth not in caps.bit_depths:",
        "if not pattern.bit_depth:",
    ),
    Fault(
        "too many patterns",
        PROJECTOR_BASE,
        "if not 1 <= len(patterns) <= caps.max_patterns:",
        "if not 1 <= len(patterns):",
    ),
    Fault(
        "half a load",
        PROJECTOR_BASE,
        "        for pattern in patterns:\n            self._check_pattern(pattern, caps)\n",
        "        for pattern in patterns:\n            self._check_pattern(pattern, caps)\n"
        "            self._loaded = (*self._loaded, pattern)\n",
    ),
    Fault("patterns are not copied", PROJECTOR_BASE, "pattern.image.copy()", "pattern.image.view()"),
    Fault(
        "playing without a trigger output",
        PROJECTOR_BASE,
        "if not caps.trigger_outputs:",
        "if caps.trigger_outputs < 0:",
    ),
    Fault("playing too fast", PROJECTOR_BASE, "if not exposure_s >= least:", "if exposure_s < 0:"),
    Fault(
        "shown while it plays",
        PROJECTOR_BASE,
        "            self._play(exposure_s, dark_s)\n        self._state = State.ARMED\n",
        "            self._play(exposure_s, dark_s)\n",
    ),
    Fault(
        "off by one",
        REFERENCE,
        "self._bench.on_show = self._held[i]",
        "self._bench.on_show = self._held[i - 1]",
    ),
    Fault(
        "blank is not dark",
        REFERENCE,
        "    def _blank(self) -> None:\n        self._bench.on_show = None\n",
        "    def _blank(self) -> None:\n        self._bench.pulses.clear()\n",
    ),
    Fault(
        "closing is not dark",
        REFERENCE,
        "    def _close(self) -> None:\n        self._bench.on_show = None\n",
        "    def _close(self) -> None:\n        self._held = []\n",
    ),
    Fault(
        "not quantised",
        REFERENCE,
        "image=quantise(p.image / 255.0, p.bit_depth)",
        "image=p.image",
    ),
    Fault("pattern ids are lost", REFERENCE, "replace(p, image=", 'replace(p, id="", image='),
    Fault("a replayed frame is another's", REPLAY, "session.read(index)", "session.read(max(index - 1, 0))"),
    Fault(
        "a replayed pattern is another", REPLAY, "shown = self._indices[i]", "shown = self._indices[i - 1]"
    ),
]

STAGE_AND_FIXTURE = [
    Fault("moves without homing", STAGE_BASE, "if not self._homed:", "if self._homed is None:"),
    Fault(
        "moves are clamped",
        STAGE_BASE,
        "        if not least <= mm <= most:\n",
        "        mm = min(max(mm, least), most)\n        if not least <= mm <= most:\n",
    ),
    Fault(
        "the position asked for is returned",
        STAGE_BASE,
        "time.monotonic() + timeout_s)\n            return self._position_mm()",
        "time.monotonic() + timeout_s)\n            return mm",
    ),
    Fault(
        "a halt keeps the reference",
        STAGE_BASE,
        'doing="halt")\n        self._homed = False\n',
        'doing="halt")\n',
    ),
    Fault("any item", FIXTURE_BASE, "if items is not None and item not in items:", "if not item:"),
    Fault("one pose too many", FIXTURE_BASE, "and pose >= poses):", "and pose > poses):"),
]

IN_STEP = [
    Fault("never dark again", ACQUISITION, "        rig.make_dark()\n", "        pass\n"),
    Fault(
        "dark only once the exception is forgotten",
        ACQUISITION,
        "from contextlib import closing\n",
        "from contextlib import nullcontext as closing\n",
    ),
    Fault("lit when the camera cannot stop", RIG, "both.callback(safe)", "safe()"),
    Fault("the pattern before", ACQUISITION, "projector.show(i)", "projector.show(max(i - 1, 0))"),
    Fault(
        "another pattern is not noticed",
        ACQUISITION,
        "if frame.pattern_id not in (None, pattern.id):",
        "if False:",
    ),
    Fault(
        "frames out of step are not noticed",
        ACQUISITION,
        "    if not verdict.in_step:\n        raise _out_of_step",
        "    if False:\n        raise _out_of_step",
    ),
    Fault(
        "a slip in frames that prove nothing is not noticed",
        ACQUISITION,
        "if ends and not _ended(brightness):",
        "if False:",
    ),
    Fault(
        "out of step is taken for noise", SYNCHRONISATION, "likelihood[0] + CERTAIN", "likelihood[0] + 1e3"
    ),
    Fault("a marker that follows anything", MARKER, "FOLLOWS = 0.015\n", "FOLLOWS = 1.0\n"),
    Fault(
        "a wrong pattern id",
        ACQUISITION,
        "shot.showing(patterns[index].id,",
        "shot.showing(patterns[index - 1].id,",
    ),
    Fault(
        "everything taken again",
        ACQUISITION,
        "wanted = session.missing()",
        "wanted = list(range(plan.images))",
    ),
    Fault("one frame short", ACQUISITION, "wanted = session.missing()", "wanted = session.missing()[:-1]"),
    Fault(
        "played before the camera listens",
        ACQUISITION,
        '    camera.arm(len(patterns), "hardware")\n'
        "    projector.play(settings.exposure_s + camera.caps.readout_s, camera.caps.dark_s)\n",
        "    projector.play(settings.exposure_s + camera.caps.readout_s, camera.caps.dark_s)\n"
        '    camera.arm(len(patterns), "hardware")\n',
    ),
    Fault(
        "the next pattern before the last row is read",
        ACQUISITION,
        "settings.exposure_s + camera.caps.readout_s,",
        "settings.exposure_s,",
    ),
    Fault("lit while rows end", ACQUISITION, "readout_s, camera.caps.dark_s)", "readout_s)"),
    Fault(
        "stepped with a global reset",
        ACQUISITION,
        "    if camera.caps.dark_s:\n",
        "    if camera.caps.dark_s < 0:\n",
    ),
    Fault("darkness of any length", PROJECTOR_BASE, "if not dark_s >= 0:", "if dark_s < -1e9:"),
]

SIMULATED = [
    Fault("simulated: off by one", SIM, "Show(self._loaded, i)", "Show(self._loaded, i - 1)"),
    Fault(
        "simulated: blank is not dark",
        SIM,
        "    def _blank(self) -> None:\n        self._bench.show = None\n",
        "    def _blank(self) -> None:\n        self._loaded = self._loaded\n",
    ),
    Fault(
        "simulated: counts on after a stop", SIM, "        self._index = 0  #", "        self._index += 0  #"
    ),
]
