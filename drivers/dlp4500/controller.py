"""Sequences of the DLPC350: stopped before anything is changed, validated, started, and watched.

A sequence's status is read once it has started, because a valid sequence is not necessarily a running one.
Every wait has a time limit.

Source: TI's DLPC350 client, GUI and SDK, and what their users report. Not yet tested on a board.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from drivers.clock import Polling
from drivers.dlp4500 import protocol
from drivers.dlp4500.board import (
    HARDWARE_FAULTS,
    VALIDATION_ERRORS,
    VALIDATION_WARNINGS,
    ProjectorBoard,
    hardware_faults,
    validation_messages,
)
from drivers.dlp4500.protocol import DisplayMode, Mailbox, Run, Source
from drivers.dlp4500.sequence import Program
from fpplab.core.errors import DeviceError, ProtocolError

VALIDATION = Polling(step_s=0.01, limit_s=2.0)
"""TI's SDK asks every 10 ms; the limit is chosen, as existing clients wait without one."""
START = Polling(step_s=0.01, limit_s=0.2)
"""Until a sequence is shown to run (chosen; a sequence that is shorter may have ended before)."""
END = Polling(step_s=0.005, limit_s=1.0)
"""Beyond the duration of a sequence that is not repeated (chosen; the first video frame is waited for)."""


class Controller(ProjectorBoard):
    """The DLPC350 behind a link; what sends commands may raise the errors of `Link.write` and `Link.read`."""

    def run(self, program: Program) -> None:
        # The LEDs stay off until the start: if the cable fails before, the light could not be switched off
        # any more.
        self.leds_off()
        self.prepare(program)
        self.start_prepared(program)

    def prepare(self, program: Program) -> None:
        """Stop, configure a sequence and have the controller validate it."""
        # The order of TI's GUI: a validation does not survive a change of mode, tables are only written while
        # the sequence is stopped, and every change has to be validated again.
        self.set_display_mode(DisplayMode.PATTERN)
        self.stop()
        self.link.write(protocol.PATTERN_SOURCE, source=program.source)
        self._configure(program)
        self.link.write(protocol.TRIGGER_MODE, mode=program.trigger_mode)
        self._write_patterns(program)
        if program.source is Source.FLASH:
            self._write_images(program)
        self.validate()

    def validate(self) -> None:
        # Warnings do not keep a sequence from running: patterns from the video port always have that of
        # missing black. They are stored, to be reported if it does not run.
        self.link.write(protocol.VALIDATE)
        result = self.link.read(protocol.VALIDATE)  # not judged: it may be that of the sequence before

        def done() -> bool:
            nonlocal result
            result = self.link.read(protocol.VALIDATE)
            return not result["busy"]

        self._clock.sleep(VALIDATION.step_s)
        self._poll_until(done, "validation", "does not end", VALIDATION)
        self._warnings = validation_messages(result, VALIDATION_WARNINGS)
        if messages := validation_messages(result, VALIDATION_ERRORS):
            raise ProtocolError(self._name, "validation", "; ".join(messages), "change the plan's exposure")

    def start_prepared(self, program: Program) -> None:
        """Switch the LEDs on, start the prepared sequence and check that it runs."""
        # A board may show a little later that it runs, and may ignore the first order: other clients order
        # twice. A sequence that may end before it is shown to run is ordered twice at once, which has no
        # effect while it runs; but once only, where the second order may come after its end.
        self.link.write(protocol.LED_ENABLE, red=0, green=0, blue=0, sequenced=1)
        standing = hardware_faults(self.link.read(protocol.HARDWARE_STATUS))
        took_s = self._order_start()
        is_short = not program.repeat and program.duration_s < START.limit_s
        if is_short and took_s < program.duration_s / 2:  # later it might have ended, and would run again
            self._order_start()
        faults = self._faults_until_running(standing)
        if faults == [] and not is_short:
            self._order_start()
            faults = self._faults_until_running(standing)
        if faults is None or (is_short and not faults):
            return
        reasons = ["the sequence does not run", *faults, *self._warnings]
        remedy = "try it again"
        if program.source is Source.VIDEO:
            remedy += "; if it fails again, switch the projector off and on with its HDMI cable plugged in"
        raise ProtocolError(self._name, "start", "; ".join(reasons), remedy)

    def _order_start(self) -> float:
        """Order the start, and give the s until it was acknowledged."""
        begun = self._clock.now()
        self.link.write(protocol.SEQUENCE, run=Run.START)
        return self._clock.now() - begun

    def _faults_until_running(self, standing: Sequence[str]) -> list[str] | None:
        """Watch after an order; None once the sequence runs, otherwise the faults that have come with it."""
        # A flag may stand from an earlier run, and an image that is late does not keep a sequence from
        # running.
        harmless = {*standing, HARDWARE_FAULTS["forced_swap_error"]}
        begun = self._clock.now()
        while True:
            status = self.status()
            if status.main["running"]:
                return None
            if faults := [fault for fault in status.faults if fault not in harmless]:
                return faults
            if self._clock.now() - begun >= START.limit_s:
                return []
            self._clock.sleep(START.step_s)

    def await_end(self, program: Program) -> None:
        """Wait until a sequence that is not repeated has ended, a first wait for a video frame included."""
        self._poll_until(
            lambda: not self.link.read(protocol.MAIN_STATUS)["running"],
            "play",
            "the sequence still runs",
            Polling(END.step_s, END.limit_s + program.duration_s),
        )

    def has_forced_swap(self) -> bool:
        """Tell whether an image was loaded too late and an older one was shown in its place."""
        return bool(self.link.read(protocol.HARDWARE_STATUS)["forced_swap_error"])

    def _configure(self, program: Program) -> None:
        counts = {
            "entries": len(program.entries),
            "patterns": len(program.entries),  # the number after which a sequence that is not repeated ends
            "images": max(1, len(program.images)),
            "repeat": int(program.repeat),
        }
        if program.variable:
            self.link.write(protocol.VARIABLE_CONFIG, **counts)
            return
        self.link.write(protocol.PATTERN_CONFIG, **counts)
        self.link.write(protocol.EXPOSURE, exposure_us=program.exposure_us, period_us=program.period_us)

    def _write_patterns(self, program: Program) -> None:
        if not program.variable:
            with self._open_mailbox(Mailbox.PATTERNS):
                self.link.write(protocol.MAILBOX_ADDRESS, address=0)
                self.link.write_bytes(protocol.MAILBOX_DATA, program.pattern_table())
            return
        times = {"exposure_us": program.exposure_us, "period_us": program.period_us}
        with self._open_mailbox(Mailbox.VARIABLE):
            for i, entry in enumerate(program.entries):
                self.link.write(protocol.VARIABLE_ADDRESS, address=i)
                self.link.write(protocol.VARIABLE_DATA, **entry.values(), **times)

    def _write_images(self, program: Program) -> None:
        address = protocol.VARIABLE_ADDRESS if program.variable else protocol.MAILBOX_ADDRESS
        with self._open_mailbox(Mailbox.IMAGES):
            self.link.write(address, address=0)
            self.link.write_bytes(protocol.MAILBOX_DATA, program.image_table())

    @contextmanager
    def _open_mailbox(self, table: Mailbox) -> Iterator[None]:
        """Open a table for writing, and close it also when writing fails."""
        self.link.write(protocol.MAILBOX, table=table)
        try:
            yield
            self.link.write(protocol.MAILBOX, table=Mailbox.CLOSED)
        except BaseException:
            with suppress(DeviceError):  # the original failure is the one to report
                self.link.write(protocol.MAILBOX, table=Mailbox.CLOSED)
            raise
