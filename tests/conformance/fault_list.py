"""The seeded faults: what goes wrong, where, and how it is written."""

from __future__ import annotations

from dataclasses import dataclass

DEVICE = "fpplab/devices/device.py"
CAMERA_BASE = "fpplab/devices/camera.py"
PROJECTOR_BASE = "fpplab/devices/projector.py"
STAGE_BASE = "fpplab/devices/stage.py"
FIXTURE_BASE = "fpplab/devices/fixture.py"
ACQUISITION = "fpplab/acquisition.py"
RIG = "fpplab/rig.py"
REPLAY = "fpplab/replay.py"
REFERENCE = "tests/conformance/reference.py"
SIM = "sim/devices.py"
BASLER, BASLER_FEATURES, BASLER_FRAMES, BASLER_OPTIONS = (
    f"drivers/basler/{name}.py" for name in ("camera", "features", "frames", "options")
)
STAGE, STAGE_WIRE = "drivers/stage_grbl/device.py", "drivers/stage_grbl/wire.py"
DLP_LINK, DLP_CONTROLLER, DLP_SEQUENCE, DLP_DEVICE = (
    f"drivers/dlp4500/{name}.py" for name in ("transport", "controller", "sequence", "device")
)


@dataclass(frozen=True)
class Fault:
    """`old`, which stands once in `file`, becomes `new`."""

    name: str
    file: str
    old: str
    new: str


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
        '            raise TimeoutError(self.name, "read", "no trigger came", "see to the trigger cable")',
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
        "            self._play(exposure_s)\n        self._state = State.ARMED\n",
        "            self._play(exposure_s)\n",
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
        "    projector.play(settings.exposure_s + camera.caps.readout_s)\n",
        "    projector.play(settings.exposure_s + camera.caps.readout_s)\n"
        '    camera.arm(len(patterns), "hardware")\n',
    ),
    Fault(
        "the next pattern before the last row is read",
        ACQUISITION,
        "projector.play(settings.exposure_s + camera.caps.readout_s)",
        "projector.play(settings.exposure_s)",
    ),
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

DRIVER_OF_BASLER = [
    Fault(
        "basler: triggered before it is ready",
        BASLER,
        '            self._await_ready(deadline, "read")\n',
        "",
    ),
    Fault(
        "basler: armed before it is ready",
        BASLER,
        '        self._await_ready(time.monotonic() + READY_S, "arm")\n',
        "",
    ),
    Fault(
        "basler: still armed in fault",
        BASLER,
        "                self._camera.StopGrabbing()\n\n",
        "                self._camera.IsGrabbing()\n\n",
    ),
    Fault("basler: damaged frames pass", BASLER, "if not result.GrabSucceeded():", "if result is None:"),
    Fault(
        "basler: the host counts",
        BASLER,
        "self._taken if block_id == NO_BLOCK_ID else block_id - self._first_block",
        "self._taken",
    ),
    Fault("basler: every link counts from 0", BASLER, 'FIRST_BLOCK = {"BaslerGigE": 1}', "FIRST_BLOCK = {}"),
    Fault(
        "basler: only pylon's notice counts",
        BASLER,
        " or self._options.serial not in self._transport.cameras()",
        "",
    ),
    Fault(
        "basler: the first camera will do",
        BASLER,
        "attach(connected[serial])",
        "attach(next(iter(connected.values())))",
    ),
    Fault(
        "basler: a camera in use is a mystery",
        BASLER,
        'IN_USE = ("exclusively opened", "controlled by another application")',
        "IN_USE = ()",
    ),
    Fault(
        "basler: the readout takes no time",
        BASLER,
        "return float(readout_us or 0.0) / US_PER_S",
        "return 0.0",
    ),
    Fault(
        "basler: settings from a file while it is armed",
        BASLER,
        'self._need(State.IDLE, doing="load_features")',
        'self._need(State.IDLE, State.ARMED, doing="load_features")',
    ),
    Fault(
        "basler: still configured after a file",
        BASLER,
        '        self._forget()\n        with self._guard("load_features"):',
        '        with self._guard("load_features"):',
    ),
    Fault(
        "basler: the line's delay for every trigger",
        BASLER,
        "delay_us = line.delay_us if hardware else 0.0",
        "delay_us = line.delay_us",
    ),
    Fault(
        "basler: what is out of range is clamped",
        BASLER_FEATURES,
        "        if refusal := _refusal(node, value):",
        "        if not isinstance(value, str):\n"
        "            value = min(max(value, node.GetMin()), node.GetMax())\n"
        "        if refusal := _refusal(node, value):",
    ),
    Fault("basler: the exposure stays automatic", BASLER_FEATURES, '    (("ExposureAuto",), "Off"),\n', ""),
    Fault(
        "basler: old names first",
        BASLER_FEATURES,
        '("ExposureTime", "ExposureTimeAbs")',
        '("ExposureTimeAbs", "ExposureTime")',
    ),
    Fault("basler: pylon fills a frame again", BASLER_FRAMES, "        self._result = result\n", ""),
    Fault(
        "basler: every buffer is given away",
        BASLER_FRAMES,
        "if len(self._lent) >=",
        "if len(self._lent) > 1000 +",
    ),
    Fault("basler: rows have no margin", BASLER_FRAMES, " + result.GetPaddingX()", ""),
    Fault(
        "basler: halves of packed pixels swapped",
        BASLER_FRAMES,
        "low + (middle & 0x0F)",
        "low + (middle >> 4)",
    ),
    Fault(
        "basler: the other edge",
        BASLER_OPTIONS,
        '"rising": "RisingEdge", "falling": "FallingEdge"',
        '"rising": "FallingEdge", "falling": "RisingEdge"',
    ),
]

DRIVER_OF_GRBL = [
    Fault("grbl: an alarm is ignored", STAGE_WIRE, "case Alarm(code):", "case Alarm(code) if code < 0:"),
    Fault("grbl: a restart is ignored", STAGE_WIRE, "case Welcome():", "case Welcome(''):"),
    Fault("grbl: a refusal is ignored", STAGE_WIRE, "if isinstance(answer, Refused):", "if answer is None:"),
    Fault(
        "grbl: noise is ignored",
        STAGE_WIRE,
        "        except ValueError as error:\n            raise ProtocolError(",
        "        except ValueError as error:\n            return True\n            raise ProtocolError(",
    ),
    Fault(
        "grbl: an answer to another program counts",
        STAGE_WIRE,
        "        if self._answers:\n            raise",
        "        if self._answers is None:\n            raise",
    ),
    Fault(
        "grbl: silence is success",
        STAGE_WIRE,
        "if not self.answered(doing, line, timeout_s):",
        "if self.answered(doing, line, timeout_s) is None:",
    ),
    Fault("grbl: the port is shared", STAGE_WIRE, "exclusive=True", "exclusive=False"),
    Fault(
        "grbl: unplugging is not understood",
        STAGE_WIRE,
        "except OSError as error:\n            raise self._gone(doing) from error\n        self._r",
        "except ZeroDivisionError as error:\n            raise self._gone(doing) from error\n        self._r",
    ),
    Fault(
        "grbl: planned is arrived",
        STAGE,
        'while not wire.answered("move_to", AFTER_MOTION, POLL_S):',
        'while wire.answered("move_to", AFTER_MOTION, POLL_S) is None:',
    ),
    Fault("grbl: reset without braking", STAGE, "        wire.realtime(doing, HOLD)\n", ""),
    Fault(
        "grbl: stopped elsewhere",
        STAGE,
        "if abs(reached - target) > mechanics.tolerance_mm:",
        "if abs(reached - target) > 1e9:",
    ),
    Fault(
        "grbl: moved by another program",
        STAGE,
        "abs(here - self._rest_mm) > self._open_mechanics.told_mm:",
        "abs(here - self._rest_mm) > 1e9:",
    ),
    Fault(
        "grbl: the switch is not looked at",
        STAGE,
        "if self._options.axis in report.pins:",
        "if not report:",
    ),
    Fault("grbl: any state is rest", STAGE, 'if report.state != "Idle":', "if not report.state:"),
    Fault(
        "grbl: inches for millimetres",
        STAGE,
        "return report.machine[self._axis] * unit_mm",
        "return report.machine[self._axis]",
    ),
    Fault("grbl: the work offset is forgotten", STAGE, " + self._offset[self._axis])", ")"),
    Fault("grbl: the wrong way", STAGE, "away=1 if int(", "away=-1 if int("),
    Fault("grbl: work coordinates", STAGE, "G90G21G53G0", "G90G21G0"),
    Fault("grbl: units as left behind", STAGE, "G90G21G53G0", "G90G53G0"),
    Fault("grbl: left moving", STAGE, '            self._stop(wire, "close")\n', "            pass\n"),
    Fault("grbl: any version", STAGE, 're.fullmatch(r"1\\.1[a-z]?", version)', "version"),
    Fault("grbl: no homing", STAGE, "if not settings.get(22):", "if settings.get(22) is None:"),
    Fault(
        "grbl: travel up to the switch",
        STAGE,
        "usable_mm=settings[130 + axis] - pull_off_mm - step_mm,",
        "usable_mm=settings[130 + axis],",
    ),
    Fault(
        "grbl: home is not zero",
        STAGE,
        "self._home_mm = self._rest_mm = self._machine",
        "self._rest_mm = self._machine",
    ),
    Fault("grbl: gone while it moved", STAGE, "            if self._moving:", "            if wire is None:"),
    Fault(
        "grbl: an old welcome is the answer",
        STAGE,
        "except RestartedError:",
        "except ZeroDivisionError:",
    ),
]

DRIVER_OF_DLP4500 = [
    Fault("dlp4500: refusals pass", DLP_LINK, "if reply.failed:", "if False:"),
    Fault(
        "dlp4500: silence is an answer",
        DLP_LINK,
        "        if not report:\n            raise TimeoutError(",
        "        if not report:\n            return bytes(64)\n            raise TimeoutError(",
    ),
    Fault("dlp4500: any answer will do", DLP_LINK, "head.sequence == sequence and ", ""),
    Fault("dlp4500: all requests are alike", DLP_LINK, "sequence = self.requests % 256", "sequence = 0"),
    Fault(
        "dlp4500: what is gone is silent",
        DLP_LINK,
        "        if sent < 0:\n            raise self._gone(operation)\n",
        "",
    ),
    Fault("dlp4500: the first interface", DLP_LINK, 'd["interface_number"] in (-1, INTERFACE) and ', ""),
    Fault(
        "dlp4500: changed while it runs",
        DLP_CONTROLLER,
        "        self.show_mode(Mode.PATTERN)\n        self.stop()\n",
        "        self.show_mode(Mode.PATTERN)\n",
    ),
    Fault(
        "dlp4500: started without validation",
        DLP_CONTROLLER,
        "            self._write_images(program)\n        self.validate()\n",
        "            self._write_images(program)\n",
    ),
    Fault(
        "dlp4500: the verdict is not read",
        DLP_CONTROLLER,
        "if words := objections(found):",
        "if (words := objections(found)) and not words:",
    ),
    Fault(
        "dlp4500: a busy validation is a good one",
        DLP_CONTROLLER,
        'if found["busy"]:',
        'if found["busy"] > 1:',
    ),
    Fault(
        "dlp4500: started is running",
        DLP_CONTROLLER,
        'if status.main["running"]:',
        'if "running" in status.main:',
    ),
    Fault(
        "dlp4500: LEDs the wrong way round",
        DLP_CONTROLLER,
        "LED_FULL - levels[colour] if inverted else levels[colour]",
        "levels[colour]",
    ),
    Fault(
        "dlp4500: dark by stopping alone",
        DLP_CONTROLLER,
        "            both.callback(self._insist, self.leds_off)  # which comes first\n",
        "",
    ),
    Fault(
        "dlp4500: dark is tried once",
        DLP_CONTROLLER,
        "        except (ProtocolError, TimeoutError):\n            order()\n",
        "        except ZeroDivisionError:\n            order()\n",
    ),
    Fault(
        "dlp4500: the mailbox stays open",
        DLP_CONTROLLER,
        "            yield\n            self.link.write(protocol.MAILBOX, table=Mailbox.CLOSED)\n",
        "            yield\n",
    ),
    Fault(
        "dlp4500: a run of another length",
        DLP_CONTROLLER,
        '"patterns": len(program.entries),',
        '"patterns": min(3, len(program.entries)),',
    ),
    Fault(
        "dlp4500: two images in their order",
        DLP_SEQUENCE,
        "reversed(self.images) if len(self.images) == 2 else self.images",
        "self.images",
    ),
    Fault("dlp4500: a gap of 230", DLP_SEQUENCE, "LEAST_GAP_US = 231", "LEAST_GAP_US = 230"),
    Fault("dlp4500: images are not waited for", DLP_SEQUENCE, "return max(waits)", "return 0"),
    Fault(
        "dlp4500: one image for all",
        DLP_SEQUENCE,
        "swap = not images or slot.image != images[-1]",
        "swap = not images",
    ),
    Fault(
        "dlp4500: patterns by their names",
        "drivers/dlp4500/index.py",
        "(p.bits, p.sha256) == (bits, sha256)",
        "p.id == name",
    ),
    Fault(
        "dlp4500: opens as it was left",
        DLP_DEVICE,
        "        controller.go_dark()\n        controller.show_mode(Mode.PATTERN)\n",
        "        controller.show_mode(Mode.PATTERN)\n",
    ),
    Fault(
        "dlp4500: lit after a failure",
        DLP_DEVICE,
        "                self._board.go_dark()\n            except DeviceError",
        "                self._board.status()\n            except DeviceError",
    ),
    Fault(
        "dlp4500: closing is not dark",
        DLP_DEVICE,
        "        try:\n            controller.go_dark()\n        finally:\n",
        "        try:\n            controller.status()\n        finally:\n",
    ),
]

FAULTS: list[Fault] = (
    LIFE
    + CAMERA
    + PROJECTOR
    + STAGE_AND_FIXTURE
    + IN_STEP
    + SIMULATED
    + DRIVER_OF_BASLER
    + DRIVER_OF_DLP4500
    + DRIVER_OF_GRBL
)
