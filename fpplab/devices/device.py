"""The life of every instrument: states, the guard, the safe end."""

import inspect
import logging
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar, final

from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    FppError,
    LimitError,
    NotOpenError,
    SettingError,
    StateError,
)

_log = logging.getLogger(__name__)
V = TypeVar("V")


class State(StrEnum):
    """Where a device is in its life."""

    CLOSED = "closed"
    IDLE = "idle"
    ARMED = "armed"
    FAULT = "fault"


@dataclass(frozen=True)
class DeviceInfo:
    """Identity of a device."""

    kind: str  # camera, projector, stage or fixture
    model: str  # as the device reports it
    serial: str  # as the device reports it
    link: str  # how it is connected


class Device(ABC):
    """An instrument with a name, a state and a safe end.

    A backend is a subclass that fills in the hooks, the methods that begin with an underscore; the public
    methods are final. It is constructed by the rig. Hooks are called one at a time, from the thread that
    calls the public method, and only in the states that the public method allows.

    Parameters
    ----------
    name : str
        The device's section in the rig file, for messages.
    options : dict of str to Any
        The rest of that section, for `_setup`.
    shared : SharedBackend or None
        What the rig's devices share (the rig file's `bench`), for `_setup`.
    """

    kind = "device"

    def __init__(self, name: str, options: dict[str, Any], shared: Any = None) -> None:
        self.name = name
        self._state = State.CLOSED
        self._setup(options, shared)

    @property
    @final
    def state(self) -> State:
        """The present state."""
        return self._state

    @final
    def open(self) -> None:
        """Connect; afterwards the device is IDLE.

        Raises
        ------
        StateError
            It is open already.
        DeviceError
            It cannot be opened; it is CLOSED then.
        """
        if self._state is not State.CLOSED:
            raise StateError(self.name, "open", f"is {self._state} already", "close it first")
        self._forget()
        try:
            with self._guard("open"):
                self._open()
        except BaseException:
            self._close_quietly()
            raise
        self._state = State.IDLE

    @final
    def close(self) -> None:
        """Leave the bench safe and release the device; legal from any state, any number of times.

        Raises
        ------
        DeviceError
            The device could not be made safe; it is CLOSED all the same.
        """
        if self._state is State.CLOSED:
            return
        try:
            with self._guard("close"):
                self._close()
        finally:
            self._state = State.CLOSED

    @final
    def __enter__(self) -> Self:
        self.open()
        return self

    @final
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @final
    def info(self) -> DeviceInfo:
        """Return model, serial number and connection of an open device.

        Returns
        -------
        DeviceInfo
            As the device reports them.
        """
        self._need(State.IDLE, State.ARMED, doing="info")
        with self._guard("info"):
            return self._of_kind(DeviceInfo, self._info(), "_info")

    def _need(self, *allowed: State, doing: str) -> None:
        if self._state in allowed:
            return
        if self._state is State.CLOSED:
            raise NotOpenError(self.name, doing, "is not open", "open it first")
        if self._state is State.FAULT:
            raise StateError(self.name, doing, "is in fault", "close it and open it again")
        raise StateError(self.name, doing, f"is {self._state}", "stop it first")

    @contextmanager
    def _guard(self, operation: str) -> Iterator[None]:
        """Run a hook: refusals pass, anything else becomes a `DeviceError` and faults the device."""
        try:
            yield
        except (SettingError, CapabilityError, LimitError, StateError):
            raise
        except FppError:
            self._fault()
            raise
        except Exception as error:
            self._fault()
            _log.debug("%s: %s failed", self.name, operation, exc_info=error)
            reason = f"{type(error).__name__}: {error}{self._line_of(error)}"
            raise DeviceError(self.name, operation, reason, "--log FILE keeps where it comes from") from error

    def _line_of(self, error: Exception) -> str:
        """File and line of the driver that an error passed last, in brackets; empty where it passed none."""
        source = inspect.getsourcefile(type(self))
        lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename == source]
        return f" ({Path(source).name}, line {lines[-1]})" if source and lines else ""

    def _of_kind(self, kind: type[V], value: V, hook: str) -> V:
        """Refuse what a hook returns where it is of another type."""
        if not isinstance(value, kind):
            returned = f"{type(self).__name__}.{hook} gives {type(value).__name__}"
            raise TypeError(f"{returned}, not {kind.__name__}; fix the driver")
        return value

    def _fault(self) -> None:
        if self._state is not State.CLOSED:
            self._state = State.FAULT

    def _close_quietly(self) -> None:
        try:
            self._close()
        except Exception:  # noqa: BLE001 - the failure to open is what the operator must see
            self._state = State.CLOSED

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        """Read the options of the rig file. Override it if the backend has any.

        Called once, by the constructor; nothing may be opened yet::

            def _setup(self, options, shared):
                self._port = options.pop("port", "/dev/ttyUSB0")
                super()._setup(options, shared)  # refuses the rest

        Parameters
        ----------
        options : dict of str to Any
            The section's keys but for `backend`, and of a camera `bits`, `gain_db` and `dead_time_s`, of a
            stage `soft_limits_mm`. Names of files in the rig file's folder are absolute.
        shared : SharedBackend or None
            What the rig file's `bench` names, which is open already.

        Raises
        ------
        ConfigError
            A key is unknown, or its value is wrong; the message names the key.
        """
        if options:
            raise ConfigError(f"'{self.name}' has no option '{next(iter(options))}'; take it away")

    @property
    @final
    def temperature_c(self) -> float | None:
        """Its temperature in °C, as the device reports it; None where it has no thermometer."""
        self._need(State.IDLE, State.ARMED, doing="temperature_c")
        with self._guard("temperature_c"):
            return self._temperature_c()

    def _temperature_c(self) -> float | None:
        """Read its temperature in °C; override it for a device that has a thermometer."""
        return None

    def _forget(self) -> None:  # noqa: B027 - not every kind of device has something to forget
        """Drop what was known of the device; called by `open`: since closing it may have been off."""

    @abstractmethod
    def _open(self) -> None:
        """Connect and bring the device into a known, safe state.

        Called by `open` in CLOSED. Afterwards every other hook may be called. If it raises, `_close` is
        called, so that what is half open need not be cleaned up here::

            def _open(self):
                self._wire = serial.Serial(self._port, timeout=1.0)

        Raises
        ------
        DeviceError
            It cannot be connected; the message says what was found and what to do. Any other exception
            becomes a `DeviceError`.
        """

    @abstractmethod
    def _close(self) -> None:
        """Make safe (dark, stopped, halted) and disconnect.

        Called by `close` in IDLE, ARMED or FAULT, and after a failed `_open`: it must work when attributes
        that `_open` sets are missing, and when the device no longer answers. The device is CLOSED afterwards
        even if it raises.

        Raises
        ------
        DeviceError
            The device may not be safe: it may still project or move.
        """

    @abstractmethod
    def _info(self) -> DeviceInfo:
        """Identify the open device; called by `info` in IDLE and ARMED.

        Returns
        -------
        DeviceInfo
            Model, serial number and connection as the device reports them; empty where it reports none.

        Raises
        ------
        DeviceError
            It does not answer.
        """
