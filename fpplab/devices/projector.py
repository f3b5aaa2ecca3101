"""The projector."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from fpplab.core.conventions import Lattice
from fpplab.core.errors import CapabilityError, SettingError, StateError
from fpplab.devices.device import Device, State
from fpplab.patterns.fringes import Pattern


@dataclass(frozen=True)
class ProjectorCaps:
    """What a projector can do.

    size: (width, height) in mirrors. bit_depths: depths it can show, with the least
    exposure in s of each. max_patterns: how many it holds at once.
    """

    size: tuple[int, int]
    lattice: Lattice
    bit_depths: dict[int, float]
    trigger_outputs: int
    max_patterns: int


class Projector(Device):
    """A projector: `load` patterns, then `show` them one by one or `play` them all."""

    kind = "projector"
    _loaded: tuple[Pattern, ...] = ()

    def _forget(self) -> None:
        self._loaded = ()

    @property
    @final
    def caps(self) -> ProjectorCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, State.ARMED, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def load(self, patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
        """Take patterns and return what will really be shown, quantised as the device does.

        Raises `SettingError` for a wrong size or depth, `CapabilityError` for too many.
        """
        self._need(State.IDLE, doing="load")
        caps = self.caps
        if not 1 <= len(patterns) <= caps.max_patterns:
            raise CapabilityError(
                self.name, "load", f"{len(patterns)} patterns given", f"holds 1 to {caps.max_patterns}"
            )
        for pattern in patterns:
            self._check_pattern(pattern, caps)
        with self._guard("load"):
            self._loaded = tuple(self._load([_kept(pattern) for pattern in patterns]))
        return self._loaded

    @final
    def show(self, i: int) -> None:
        """Show loaded pattern `i` until told otherwise."""
        self._need(State.IDLE, doing="show")
        if not 0 <= i < len(self._loaded):
            raise SettingError(
                self.name, "show", f"pattern {i} was asked for", f"{len(self._loaded)} are loaded"
            )
        with self._guard("show"):
            self._show(i)

    @final
    def play(self, exposure_s: float, dark_s: float = 0.0) -> None:
        """Show every loaded pattern once, `exposure_s` each, giving a trigger pulse with each.

        At least `dark_s` of darkness follow each. The projector is ARMED until `blank`.
        Raises `CapabilityError` without trigger output, or for darkness that it cannot make; `SettingError`
        for too short an exposure.
        """
        self._need(State.IDLE, doing="play")
        caps = self.caps
        if not caps.trigger_outputs:
            raise CapabilityError(self.name, "play", "has no trigger output", "use a stepped plan")
        if not self._loaded:
            raise StateError(self.name, "play", "has no patterns", "load some first")
        least = max(caps.bit_depths[p.bit_depth] for p in self._loaded)
        if not exposure_s >= least:
            raise SettingError(self.name, "play", f"exposure_s is {exposure_s:g} s", f"at least {least:g} s")
        if not dark_s >= 0:
            raise SettingError(self.name, "play", f"dark_s is {dark_s:g} s", "at least 0 s")
        with self._guard("play"):
            self._play(exposure_s, dark_s)
        self._state = State.ARMED

    @final
    def blank(self) -> None:
        """Go dark; legal whenever the projector is open."""
        self._need(State.IDLE, State.ARMED, doing="blank")
        with self._guard("blank"):
            self._blank()
        self._state = State.IDLE

    def _check_pattern(self, pattern: Pattern, caps: ProjectorCaps) -> None:
        width, height = caps.size
        if pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8:
            found = " x ".join(map(str, pattern.image.shape[::-1]))
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} is {pattern.image.dtype}, {found}",
                f"the projector takes uint8, {width} x {height} mirrors",
            )
        if pattern.bit_depth not in caps.bit_depths:
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} has {pattern.bit_depth} bits",
                f"the projector shows {sorted(caps.bit_depths)}",
            )

    @abstractmethod
    def _caps(self) -> ProjectorCaps: ...

    @abstractmethod
    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]: ...

    @abstractmethod
    def _show(self, i: int) -> None: ...

    @abstractmethod
    def _play(self, exposure_s: float, dark_s: float) -> None: ...

    @abstractmethod
    def _blank(self) -> None: ...


def _kept(pattern: Pattern) -> Pattern:
    """The pattern as its own, unless nobody can change it any more: then itself."""
    flags = pattern.image.flags
    if flags.owndata and not flags.writeable:
        return pattern
    image = pattern.image.copy()
    image.flags.writeable = False
    return replace(pattern, image=image)
