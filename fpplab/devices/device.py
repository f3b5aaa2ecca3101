"""The life of every instrument: states, the guard, the safe end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Any, Self, final

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


class State(StrEnum):
    """Where a device is in its life."""

    CLOSED = "closed"
    IDLE = "idle"
    ARMED = "armed"
    FAULT = "fault"


@dataclass(frozen=True)
class DeviceInfo:
    """What a device says it is: `link` is how it is connected."""

    kind: str
    model: str
    serial: str
    link: str


class Device(ABC):
    """An instrument with a name, a state and a safe end.

    Subclasses are constructed by the rig as `Backend(name, options, bench)`: `options`
    is the rest of the device's section in the rig file, `bench` what the rig's devices share.
    """

    kind = "device"

    def __init__(self, name: str, options: dict[str, Any], bench: Any = None) -> None:
        self.name = name
        self._state = State.CLOSED
        self._setup(options, bench)

    @property
    @final
    def state(self) -> State:
        """The present state."""
        return self._state

    @final
    def open(self) -> None:
        """Connect. Raises `StateError` when open already, `DeviceError` when that fails."""
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
        """Leave the bench safe and let go of the device; legal from any state, any number of times.

        Raises `DeviceError` when the device could not be made safe; it is CLOSED all the same.
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
        """Model, serial number and connection of an open device."""
        self._need(State.IDLE, State.ARMED, doing="info")
        with self._guard("info"):
            return self._info()

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
            raise DeviceError(
                self.name, operation, f"{type(error).__name__}: {error}", "see the cause in the log"
            ) from error

    def _fault(self) -> None:
        if self._state is not State.CLOSED:
            self._state = State.FAULT

    def _close_quietly(self) -> None:
        try:
            self._close()
        except Exception:  # noqa: BLE001 - the failure to open is what the operator must see
            self._state = State.CLOSED

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        """Read the options of the rig file; raise `ConfigError` for wrong ones."""
        if options:
            raise ConfigError(f"'{self.name}' has no option '{next(iter(options))}'; take it away")

    def _forget(self) -> None:  # noqa: B027 - not every kind of device has something to forget
        """Drop what was known of the device: after a closing it may have been switched off."""

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _close(self) -> None:
        """Make safe and disconnect; must work after a failed `_open` and in FAULT."""

    @abstractmethod
    def _info(self) -> DeviceInfo: ...
