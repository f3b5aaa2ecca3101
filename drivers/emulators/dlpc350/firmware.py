"""The controller itself: USB messages in and replies out, projected light and trigger pulses as results.

It does what the maker's client, GUI and SDK show of the firmware; where they are silent it follows
`Dlpc350Policy`.
"""

from collections.abc import Callable
from functools import cached_property

from drivers.dlp4500 import protocol
from drivers.dlp4500.framing import DESTINATION, ERROR, READ, REPLY_WANTED, UsbMessage
from drivers.dlp4500.layout import Command, RawBytes, RegisterLayout, Values
from drivers.dlp4500.protocol import (
    COMMANDS,
    DELAY_STEP_US,
    MAX_IMAGES,
    MAX_VARIABLE_IMAGES,
    DisplayMode,
    Mailbox,
    Run,
    Source,
    TriggerMode,
)
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350.engine import ANSWERED_ASLEEP, FIRMWARE, SEQUENCE_COMMANDS, TAG, LightEngine
from drivers.emulators.dlpc350.sequencer import SequenceTables, delay_s
from drivers.emulators.dlpc350.validation import validate_sequence
from drivers.emulators.dlpc350.video import region

_VSYNC_MODES = (TriggerMode.VSYNC, TriggerMode.VSYNC_VARIABLE)
_VARIABLE_MODES = (TriggerMode.INTERNAL_VARIABLE, TriggerMode.VSYNC_VARIABLE)


class CommandRejected(Exception):  # noqa: N818 - a message of the wire, no fault of the program
    """A command that the controller does not carry out and answers with the error bit."""


class Dlpc350(LightEngine):
    """The emulated controller; parameters and attributes are those of `LightEngine`."""

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        self.advance()
        if self.frozen or (message.flags & DESTINATION and not self.policy.answers_other_destinations):
            return None
        number = int.from_bytes(message.payload[:2], "little")
        flags, data = message.flags, b""
        try:
            data = self._execute(message, number)
            self.executed.append(number)
        except (CommandRejected, ValueError):
            flags |= ERROR
        if self.frozen or not message.flags & REPLY_WANTED:
            return None
        waking = number == protocol.POWER.number and not message.flags & READ and self._awake_at_s > 0
        if waking and self.policy.loses_wake_acknowledgement:
            return None
        return self.reply(message, flags, data)

    def nack(self, message: UsbMessage) -> UsbMessage | None:
        replies = message.flags & REPLY_WANTED
        return self.reply(message, message.flags | ERROR, b"") if replies else None

    def reply(self, message: UsbMessage, flags: int, data: bytes) -> UsbMessage:
        if not flags & READ and self.policy.acknowledges_with_command:
            data = message.payload[:2]
        return UsbMessage(flags, message.sequence if self.policy.echoes_sequence else 0, data)

    def _execute(self, message: UsbMessage, number: int) -> bytes:
        command = COMMANDS.get(number)
        if command is None or len(message.payload) < 2 or message.flags & DESTINATION:
            raise CommandRejected
        if self.is_asleep() and number not in ANSWERED_ASLEEP:
            raise CommandRejected
        if message.flags & READ:
            return self._read(command, message.payload[2:])
        self._write(command, message.payload[2:])
        return b""

    def is_asleep(self) -> bool:
        """Return whether the controller is in standby or still waking up."""
        return self.asleep or self.clock.now() < self._awake_at_s

    # --- reading

    def _read(self, command: Command, data: bytes) -> bytes:
        if data:  # only the boot loader's commands say in a read what is to be read
            raise CommandRejected
        if command is protocol.MAILBOX_DATA:
            return self._table_bytes()
        if command is protocol.VARIABLE_DATA:
            return self._variable_bytes()
        if command is protocol.FIRMWARE_TAG:
            return TAG
        if not isinstance(command.returned, RegisterLayout):
            raise CommandRejected
        return command.returned.pack(self._values(command))

    @cached_property
    def _readers(self) -> dict[int, Callable[[], Values]]:
        """List the reading functions of commands that return more than a register, by command number."""
        readers: dict[Command, Callable[[], Values]] = {
            protocol.HARDWARE_STATUS: self._hardware_status,
            protocol.SYSTEM_STATUS: lambda: {"memory_test_passed": 1},
            protocol.MAIN_STATUS: self._main_status,
            protocol.VERSION: lambda: {
                f"{part}_{field}": value for part in protocol.PARTS for field, value in FIRMWARE.items()
            },
            protocol.IMAGES_IN_FLASH: lambda: {"count": len(self.images) % 256},
            protocol.POWER: lambda: {"standby": int(self.is_asleep())},
            protocol.DISPLAY_MODE: lambda: {"mode": self.mode},
            protocol.SEQUENCE: lambda: {"run": self.sequencer.state},
            protocol.IMAGE_LOAD_TIMING: lambda: {
                "ticks": self._timing if self.clock.now() >= self._timed_s else 0
            },
            protocol.VIDEO_SIGNAL: self._video_signal,
            protocol.VALIDATE: self._validation,
        }
        return {command.number: reader for command, reader in readers.items()}

    def _values(self, command: Command) -> Values:
        if command.number in self._readers:
            return self._readers[command.number]()
        if command.number not in self._registers:
            raise CommandRejected
        return self._registers[command.number]

    def _hardware_status(self) -> Values:
        return {
            "initialised": 1,
            "reset_controller_error": 0,
            "forced_swap_error": int(self.sequencer.forced_swap),
            "sequencer_aborted": int(self._aborted),
            "sequencer_error": 0,
        }

    def _main_status(self) -> Values:
        frozen = self._registers[protocol.FREEZE.number]["on"]
        gamma = self._registers[protocol.GAMMA.number]["on"]
        shown_s = self._started_s + self.policy.running_shown_late_s
        return {
            "parked": int(self.asleep),
            "running": int(self.sequencer.running and self.clock.now() >= shown_s),
            "frozen": frozen,
            "gamma": gamma,
        }

    def _video_signal(self) -> Values:
        assert isinstance(protocol.VIDEO_SIGNAL.returned, RegisterLayout)
        signal = dict.fromkeys((field.name for field in protocol.VIDEO_SIGNAL.returned.named), 0)
        if self._is_locked():
            width, height = SIZE
            signal |= {
                "lock": protocol.LOCKED,
                "horizontal_resolution": width,
                "vertical_resolution": height,
                "active_pixels": width,
                "active_lines": height,
            }
        return signal

    def _validation(self) -> Values:
        if self._stale_reads:
            self._stale_reads -= 1
            return self._last_result
        if self._is_validating():
            return dict.fromkeys(self._validation_result, 0) | {"busy": 1}
        return self._validation_result

    def _is_validating(self) -> bool:
        return self.clock.now() < self._validated_s

    def _table_bytes(self) -> bytes:
        entries, images = self._entry_and_image_counts()
        if self._open() is Mailbox.PATTERNS:
            return self._tables.pattern_bytes(entries)
        if self._open() is Mailbox.IMAGES:
            return self._tables.image_bytes(images)
        raise CommandRejected

    def _variable_bytes(self) -> bytes:
        address = self._registers[protocol.VARIABLE_ADDRESS.number]["address"]
        if self._open() is not Mailbox.VARIABLE or address not in self._tables.variable:
            raise CommandRejected
        assert isinstance(protocol.VARIABLE_DATA.returned, RegisterLayout)
        return protocol.VARIABLE_DATA.returned.pack(self._tables.variable[address])

    # --- writing

    def _write(self, command: Command, data: bytes) -> None:
        if command.written is None:
            raise CommandRejected
        running = self.sequencer.state is not Run.STOP
        if command.number in SEQUENCE_COMMANDS:
            if running and self.policy.refuses_changes_while_running:
                raise CommandRejected
            self._unvalidated = True
        if isinstance(command.written, RawBytes):
            command.written.check(data)
            self._fill(data)
            return
        values = command.written.unpack(data)
        writer = self._writers.get(command.number)
        if writer is not None:
            writer(values)
        else:
            self._registers[command.number] = values

    @cached_property
    def _writers(self) -> dict[int, Callable[[Values], None]]:
        """List the writing functions of commands that do more than fill a register, by command number."""
        writers: dict[Command, Callable[[Values], None]] = {
            protocol.POWER: self._set_power,
            protocol.SOFTWARE_RESET: lambda values: self._reset(),
            protocol.DISPLAY_MODE: self._set_mode,
            protocol.SEQUENCE: self._order_run,
            protocol.AREA: self._set_area,
            protocol.IMAGE_LOAD_TIMING: self._time_images,
            protocol.VARIABLE_DATA: self._fill_variable,
            protocol.VALIDATE: lambda values: self._validate(),
        }
        return {command.number: writer for command, writer in writers.items()}

    def _set_power(self, values: Values) -> None:
        if values["standby"]:
            if self.mode is DisplayMode.PATTERN and not self.policy.sleeps_in_pattern_mode:
                raise CommandRejected
            self.sequencer.stop()
            self.asleep, self._awake_at_s = True, 0.0
        elif self.asleep:
            self.asleep, self._awake_at_s = False, self.clock.now() + self.policy.wake_s

    def _reset(self) -> None:
        self.restart()
        self.on_restart(self.policy.reset_s)

    def _set_mode(self, values: Values) -> None:
        mode = DisplayMode(values["mode"])
        if mode is not self._next_mode[0]:
            self._was_locked = self._is_locked()
            leaves_pattern = mode is DisplayMode.VIDEO and self._was_locked
            self.frozen = leaves_pattern and self._chances.random() < self.policy.freeze_chance
            self.sequencer.stop()
            self._unvalidated = True
            self._next_mode = (mode, self.clock.now() + self.policy.mode_change_s)

    def _set_area(self, values: Values) -> None:
        sides = [
            (side, size)
            for part in ("crop", "display")
            for side, size in zip(region(values, part), SIZE[::-1], strict=True)
        ]
        if any(side.start == side.stop or side.stop > size for side, size in sides):
            raise CommandRejected
        self._registers[protocol.AREA.number] = values

    def _order_run(self, values: Values) -> None:
        order, now = Run(values["run"]), self.clock.now()
        if order is Run.STOP:
            self.sequencer.stop()
        elif order is Run.PAUSE:
            self.sequencer.pause()
        elif self._open() is not Mailbox.CLOSED:
            raise CommandRejected
        elif self.mode is not DisplayMode.PATTERN or self._is_validating() or self.sequencer.running:
            return
        elif self._ignored_starts:
            self._ignored_starts -= 1
        else:
            self._started_s = now
            self._start(now)

    def _start(self, now: float) -> None:
        tables = self._sequence()
        locked = self._is_locked() and (self._was_locked or not self.policy.needs_lock_before_pattern_mode)
        no_signal = tables.mode in _VSYNC_MODES and not locked
        unfit = not tables.entries or any(period <= 0 for _, period in tables.times)
        self._aborted = (self._unvalidated and self.policy.needs_validation) or no_signal or unfit
        if not self._aborted:
            self.sequencer.start(tables, now)

    def _time_images(self, values: Values) -> None:
        first, count = values["first"], values["count"]
        busy = self.sequencer.running and self._is_from_flash()
        if busy or not count or first + count > len(self.images):
            raise CommandRejected
        self._timed_s = self.clock.now() + self.policy.load_timed_s
        self._timing = round(sum(self.load_s[first : first + count]) * 1e3 * protocol.TICKS_PER_MS)

    def _open(self) -> Mailbox:
        return Mailbox(self._registers[protocol.MAILBOX.number]["table"])

    def _is_variable(self) -> bool:
        return self._registers[protocol.TRIGGER_MODE.number]["mode"] in _VARIABLE_MODES

    def _fill(self, data: bytes) -> None:
        """Write mailbox data to the open table, from its address on."""
        short, long = (
            self._registers[command.number]["address"]
            for command in (protocol.MAILBOX_ADDRESS, protocol.VARIABLE_ADDRESS)
        )
        if self._open() is Mailbox.PATTERNS:
            self._tables.fill_patterns(short, data)
        elif self._open() is Mailbox.IMAGES and self._is_variable():
            self._tables.fill_images(long, data, MAX_VARIABLE_IMAGES)
        elif self._open() is Mailbox.IMAGES:
            self._tables.fill_images(short, data, MAX_IMAGES)
        else:
            raise CommandRejected

    def _fill_variable(self, values: Values) -> None:
        if self._open() is not Mailbox.VARIABLE:
            raise CommandRejected
        self._tables.fill_variable(self._registers[protocol.VARIABLE_ADDRESS.number]["address"], values)

    # --- the sequence

    def _entry_and_image_counts(self) -> tuple[int, int]:
        config = protocol.VARIABLE_CONFIG if self._is_variable() else protocol.PATTERN_CONFIG
        values = self._registers[config.number]
        return values["entries"], values["images"]

    def _entries(self) -> list[Values]:
        return self._tables.entries(self._is_variable(), self._entry_and_image_counts()[0])

    def _times_us(self) -> list[tuple[int, int]]:
        if self._is_variable():
            return [(entry["exposure_us"], entry["period_us"]) for entry in self._entries()]
        times = self._registers[protocol.EXPOSURE.number]
        return [(times["exposure_us"], times["period_us"])] * len(self._entries())

    def _images(self) -> list[int]:
        return self._tables.images_shown(self._entry_and_image_counts()[1])

    def _is_from_flash(self) -> bool:
        return self._registers[protocol.PATTERN_SOURCE.number]["source"] == Source.FLASH

    def _validate(self) -> None:
        if self._open() is not Mailbox.CLOSED:
            raise CommandRejected
        flash = self._is_from_flash()
        result = validate_sequence(
            self._entries(),
            self._times_us(),
            self._images(),
            self._entry_and_image_counts(),
            len(self.images) if flash else None,
            None if flash else 1e6 * (self.video.vsync_s if self.video else 0.0),
            self.policy.accepts_a_gap_of_230_us,
        )
        self._last_result, self._stale_reads = self._validation_result, self.policy.stale_validations
        self._validation_result = result | {"busy": 0}
        self._validated_s = self.clock.now() + self.policy.validation_s
        self._ignored_starts = self.policy.ignored_starts
        self._unvalidated = bool(result["exposure_invalid"] or result["pattern_invalid"])

    def _sequence(self) -> SequenceTables:
        config = protocol.VARIABLE_CONFIG if self._is_variable() else protocol.PATTERN_CONFIG
        declared = self._registers[config.number]
        first = self._registers[protocol.TRIGGER_OUT_1.number]
        second = self._registers[protocol.TRIGGER_OUT_2.number]
        return SequenceTables(
            mode=TriggerMode(self._registers[protocol.TRIGGER_MODE.number]["mode"]),
            entries=self._entries(),
            times=[(1e-6 * exposure, 1e-6 * period) for exposure, period in self._times_us()],
            images=self._images() if self._is_from_flash() else [],
            load_s=[self.load_s[i] if i < len(self.load_s) else 0.0 for i in range(MAX_VARIABLE_IMAGES)],
            patterns=declared["patterns"],
            repeat=bool(declared["repeat"]),
            edges_s=(delay_s(first["rising"]), delay_s(first["falling"]), delay_s(second["rising"])),
            vsync_s=self.video.vsync_s if self.video else 0.0,
            input_delay_s=self._registers[protocol.TRIGGER_IN_1.number]["delay"] * DELAY_STEP_US * 1e-6,
        )
