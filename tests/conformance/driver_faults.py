"""Faults in the drivers of real hardware."""

from __future__ import annotations

from tests.conformance.fault import Fault

BASLER, BASLER_FEATURES, BASLER_FRAMES, BASLER_OPTIONS = (
    f"drivers/basler/{name}.py" for name in ("camera", "features", "frames", "options")
)
STAGE, STAGE_WIRE = "drivers/stage_grbl/device.py", "drivers/stage_grbl/wire.py"
DLP_LINK, DLP_CONTROLLER, DLP_SEQUENCE, DLP_DEVICE, DLP_VIDEO, DLP_DISPLAY, DLP_SCREEN = (
    f"drivers/dlp4500/{name}.py"
    for name in ("transport", "controller", "sequence", "device", "on_video", "display", "screen")
)

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
        "readout_s = float(readout_us or 0.0) / US_PER_S",
        "readout_s = 0.0",
    ),
    Fault(
        "basler: a global reset rolls",
        BASLER,
        "return (0.0, readout_s) if resets else (readout_s, 0.0)",
        "return readout_s, 0.0",
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
    Fault(
        "grbl: a refusal is ignored", STAGE_WIRE, "if isinstance(answer, GrblError):", "if answer is None:"
    ),
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
        "if not self.wait_for_answer(operation, line, timeout_s):",
        "if self.wait_for_answer(operation, line, timeout_s) is None:",
    ),
    Fault("grbl: the port is shared", STAGE_WIRE, "exclusive=True", "exclusive=False"),
    Fault(
        "grbl: unplugging is not understood",
        STAGE_WIRE,
        "except OSError as error:\n"
        "            raise self._disconnected(operation) from error\n        self._r",
        "except ZeroDivisionError as error:\n"
        "            raise self._disconnected(operation) from error\n        self._r",
    ),
    Fault(
        "grbl: planned is arrived",
        STAGE,
        'while not wire.wait_for_answer("move_to", AFTER_MOTION, POLL_S):',
        'while wire.wait_for_answer("move_to", AFTER_MOTION, POLL_S) is None:',
    ),
    Fault("grbl: reset without braking", STAGE, "        wire.realtime(operation, HOLD)\n", ""),
    Fault(
        "grbl: stopped elsewhere",
        STAGE,
        "if abs(reached - target) > mechanics.tolerance_mm:",
        "if abs(reached - target) > 1e9:",
    ),
    Fault(
        "grbl: moved by another program",
        STAGE,
        "abs(here - self._rest_mm) > self._open_mechanics.rounding_mm:",
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
    Fault("grbl: the wrong way", STAGE, "direction=1 if int(", "direction=-1 if int("),
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
        "        if not report:\n            raise DeviceTimeoutError(",
        "        if not report:\n            return bytes(64)\n            raise DeviceTimeoutError(",
    ),
    Fault("dlp4500: any answer will do", DLP_LINK, "head.sequence == sequence and ", ""),
    Fault("dlp4500: all requests are alike", DLP_LINK, "sequence = self.requests % 256", "sequence = 0"),
    Fault(
        "dlp4500: what is gone is silent",
        DLP_LINK,
        "        if sent < 0:\n            raise self._disconnected(operation)\n",
        "",
    ),
    Fault("dlp4500: the first interface", DLP_LINK, 'd["interface_number"] in (-1, INTERFACE) and ', ""),
    Fault(
        "dlp4500: changed while it runs",
        DLP_CONTROLLER,
        "        self.set_display_mode(DisplayMode.PATTERN)\n        self.stop()\n",
        "        self.set_display_mode(DisplayMode.PATTERN)\n",
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
        "if words := validation_messages(found):",
        "if (words := validation_messages(found)) and not words:",
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
        "            both.callback(self._try_twice, self.leds_off)"
        "  # callbacks run in reverse: this one first\n",
        "",
    ),
    Fault(
        "dlp4500: dark is tried once",
        DLP_CONTROLLER,
        "        except (ProtocolError, DeviceTimeoutError):\n            order()\n",
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
    Fault("dlp4500: no dark but for loading", DLP_SEQUENCE, "max(exposure_us + dark_us, ", "max(0, "),
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
        "        controller.go_dark()\n        self._storage.open(controller)\n",
        "        self._storage.open(controller)\n",
    ),
    Fault(
        "dlp4500: lit after a failure",
        DLP_CONTROLLER,
        "                self.go_dark()\n            except DeviceError",
        "                self.status()\n            except DeviceError",
    ),
    Fault(
        "dlp4500: closing is not dark",
        DLP_DEVICE,
        "                ends.callback(controller.link.close)\n                controller.go_dark()\n",
        "                ends.callback(controller.link.close)\n                controller.status()\n",
    ),
]

VIDEO_PORT_OF_DLP4500 = [
    Fault("dlp4500: a frame's colours in a picture's order", DLP_VIDEO, "RGB = (1, 0, 2)", "RGB = (0, 1, 2)"),
    Fault(
        "dlp4500: channels as they come in",
        DLP_CONTROLLER,
        'BOARD_CHANNEL_SWAP = {"swap": 4,',
        'BOARD_CHANNEL_SWAP = {"swap": 0,',
    ),
    Fault(
        "dlp4500: pattern mode before the signal",
        DLP_VIDEO,
        "        board.select_video()\n",
        "",
    ),
    Fault(
        "dlp4500: the display is not waited for",
        DLP_DISPLAY,
        '        self._answer("video", SHOW_S)\n',
        "",
    ),
    Fault(
        "dlp4500: a frame runs again and again",
        DLP_VIDEO,
        "video_program(group, exposure_us, self._frame_us, self._leds)",
        "video_program(group, exposure_us, self._frame_us, self._leds, repeat=True)",
    ),
    Fault(
        "dlp4500: the end of a frame is not waited for",
        DLP_VIDEO,
        "            board.await_end(program)\n",
        "",
    ),
    Fault(
        "dlp4500: ordered is shown",
        DLP_VIDEO,
        "            self._clock.sleep(self._display.vsync_s)  # the pattern begins with the next frame\n",
        "",
    ),
    Fault(
        "dlp4500: any frame will do",
        DLP_VIDEO,
        "if slot.image != self._displayed_image:",
        "if self._displayed_image is None:",
    ),
    Fault(
        "dlp4500: more patterns than a frame has time for",
        DLP_VIDEO,
        "assign_slots(self._patterns, self._frame_us // exposure_us)",
        "assign_slots(self._patterns, 1 + self._frame_us // exposure_us)",
    ),
    Fault(
        "dlp4500: the display is kept",
        DLP_VIDEO,
        "        self._display.close()\n",
        "",
    ),
    Fault(
        "dlp4500: frames that do not wait pass",
        DLP_SCREEN,
        "if measured_s < LEAST_OF_PERIOD / reported_hz:",
        "if measured_s < 0.0:",
    ),
    Fault(
        "dlp4500: a display of any size",
        DLP_SCREEN,
        "if sizes[found[0]] != self._size:",
        "if not sizes[found[0]]:",
    ),
]
