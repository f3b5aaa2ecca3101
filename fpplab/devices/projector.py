"""Projectors; some can show a pattern for some refreshes, so that a camera can measure how long one is."""

import math
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
    """What a projector can do."""

    size: tuple[int, int]  # (width, height) in mirrors
    lattice: Lattice  # how the mirrors lie
    bit_depths: dict[int, float]  # depths that it can show, with the shortest exposure in s of each
    trigger_outputs: int  # how many outputs give a pulse with each pattern; 0 where it cannot play
    max_patterns: int  # how many it holds
    longest_s: float = math.inf  # for which a played pattern can be shown
    gap_s: float = 0.0  # to the next played pattern, where that does not follow immediately
    period_s: float = 0.0
    """Time in which a pattern that is shown repeats, its bit planes one after another: an exposure sees them
    completely if it lasts a whole number of these. 0 where light is steady, or where this is not known."""
    dark_between: bool = True  # whether it can be dark between played patterns
    trigger_inputs: int = 0  # how many inputs bring patterns; 0 where it cannot follow a camera
    flashes: bool = False
    """Whether a pattern that follows a camera is shown for a part of the exposure only."""
    leds: tuple[str, ...] = ()  # colours of the LEDs of which one alone can light a pattern


@dataclass(frozen=True)
class PatternLoads:
    """Images of the projector, such as those of its flash, from which the loaded patterns are shown."""

    images: int = 0  # how often a run changes to another, the first included; 0 where there are no images
    # Shortest time from one pattern to the next with which images load in time; 0 where none is waited for
    period_s: float = 0.0


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
            return self._of_kind(ProjectorCaps, self._caps(), "_caps")

    @property
    @final
    def loads(self) -> PatternLoads:
        """From which images the loaded patterns are shown, and the time that they need; known once loaded."""
        self._need(State.IDLE, State.ARMED, doing="loads")
        with self._guard("loads"):
            return self._loads()

    @final
    def load(self, patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
        """Take patterns and return what will really be shown, quantised as the device does.

        Parameters
        ----------
        patterns : sequence of Pattern
            In the order in which they will be shown.

        Returns
        -------
        tuple of Pattern
            As many, under the same ids.

        Raises
        ------
        SettingError
            A pattern is of a wrong size or depth.
        CapabilityError
            There are none, or too many.
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
            self._loaded = tuple(self._load([_immutable_copy(pattern) for pattern in patterns]))
        return self._loaded

    @final
    def show(self, i: int) -> None:
        """Show one loaded pattern until the next command.

        Parameters
        ----------
        i : int
            Its index among those loaded.

        Raises
        ------
        SettingError
            No such pattern is loaded.
        """
        self._need(State.IDLE, doing="show")
        if not 0 <= i < len(self._loaded):
            raise SettingError(
                self.name, "show", f"pattern {i} was asked for", f"{len(self._loaded)} are loaded"
            )
        with self._guard("show"):
            self._show(i)

    @final
    def play(self, exposure_s: float, dark_s: float = 0.0, period_s: float = 0.0) -> None:
        """Show every loaded pattern once, giving a trigger pulse with each; ARMED until `blank`.

        It returns once that has begun or, of a projector that is fed by the computer, at its end.

        Parameters
        ----------
        exposure_s : float
            Time in s that each is shown.
        dark_s : float
            Shortest darkness in s after each.
        period_s : float
            Shortest time in s from one pulse to the next; the projector need not be dark for the rest of it.

        Raises
        ------
        CapabilityError
            It has no trigger output, or cannot make such darkness.
        StateError
            No patterns are loaded.
        SettingError
            The exposure is shorter than the patterns' depth allows, or another time is negative.
        """
        self._need(State.IDLE, doing="play")
        caps = self.caps
        if not caps.trigger_outputs:
            raise CapabilityError(self.name, "play", "has no trigger output", "use a stepped plan")
        if not self._loaded:
            raise StateError(self.name, "play", "has no patterns", "load some first")
        shortest_s = max(caps.bit_depths[p.bit_depth] for p in self._loaded)
        if not exposure_s >= shortest_s:
            raise SettingError(
                self.name, "play", f"exposure_s is {exposure_s:g} s", f"at least {shortest_s:g} s"
            )
        if not dark_s >= 0:
            raise SettingError(self.name, "play", f"dark_s is {dark_s:g} s", "at least 0 s")
        if not period_s >= 0:
            raise SettingError(self.name, "play", f"period_s is {period_s:g} s", "at least 0 s")
        with self._guard("play"):
            self._play(exposure_s, dark_s, period_s)
        self._state = State.ARMED

    @final
    def follow(self, pulse_s: float) -> None:
        """Show the loaded patterns in order, one for each pulse at its input; ARMED until `blank`.

        Each is shown from the beginning of its pulse, or before, and not beyond the next one.

        Parameters
        ----------
        pulse_s : float
            Duration of the pulses in s: the camera's exposure.

        Raises
        ------
        CapabilityError
            It has no trigger input.
        StateError
            No patterns are loaded.
        SettingError
            The pulses are too short for the patterns.
        """
        self._need(State.IDLE, doing="follow")
        if not self.caps.trigger_inputs:
            raise CapabilityError(self.name, "follow", "has no trigger input", "use a stepped plan")
        if not self._loaded:
            raise StateError(self.name, "follow", "has no patterns", "load some first")
        with self._guard("follow"):
            self._follow(pulse_s)
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
            size = " x ".join(map(str, pattern.image.shape[::-1]))
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} is {pattern.image.dtype}, {size}",
                f"the projector takes uint8, {width} x {height} mirrors",
            )
        if pattern.bit_depth not in caps.bit_depths:
            raise SettingError(
                self.name,
                "load",
                f"pattern {pattern.id} has {pattern.bit_depth} bits",
                f"the projector shows {sorted(caps.bit_depths)}",
            )
        if pattern.led not in (None, *caps.leds):
            raise CapabilityError(
                self.name,
                "load",
                f"pattern {pattern.id} is lit by the {pattern.led} LED alone",
                f"the projector lights patterns by {' or '.join(caps.leds) or 'all its light'}",
            )

    @abstractmethod
    def _caps(self) -> ProjectorCaps:
        """Tell what this projector can do; called by `caps` in IDLE and ARMED, often: it must be quick.

        Returns
        -------
        ProjectorCaps
            Its capabilities: size in mirrors, times in s.
        """

    def _loads(self) -> PatternLoads:
        """Tell from which images the loaded patterns are shown; called by `loads` in IDLE and ARMED.

        Override it for a projector that keeps patterns in images which it has to read in time.

        Returns
        -------
        PatternLoads
            How many images, and the least time in s from one pattern to the next.
        """
        return PatternLoads()

    @abstractmethod
    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        """Take the patterns over, and give what will really be shown.

        Called by `load` in IDLE. Nothing may be on show afterwards::

            def _load(self, patterns):
                self._held = [replace(p, image=quantise(p.image / 255.0, p.bit_depth)) for p in patterns]
                return self._held

        Parameters
        ----------
        patterns : sequence of Pattern
            1 to `max_patterns`, of the projector's size and of depths that it has. Their images are read-only
            and stay as they are.

        Returns
        -------
        sequence of Pattern
            As many, with the same ids, their images quantised as the device does (uint8, full scale 255).

        Raises
        ------
        CapabilityError
            The device cannot show them; raised before anything has changed.
        """

    @abstractmethod
    def _show(self, i: int) -> None:
        """Show one loaded pattern, and return once it is on show.

        Called by `show` in IDLE. Where the device cannot say when the light has changed, the plan's
        `settle_s` covers the rest. It stays until the next `_show`, `_play`, `_load` or `_blank`.

        Parameters
        ----------
        i : int
            Its index among the loaded patterns, from 0.

        Raises
        ------
        DeviceError
            It cannot be shown.
        """

    @abstractmethod
    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        """Start to show every loaded pattern once, in order, with a pulse at the beginning of each.

        Called by `play` in IDLE, only where `trigger_outputs` is not 0; the camera is armed already. Return
        once the sequence runs or is sure to. A projector that needs the computer until the end returns then:
        the camera keeps the frames meanwhile.

        Parameters
        ----------
        exposure_s : float
            Time in s that each pattern is shown, at least what the depths allow.
        dark_s : float
            Least darkness in s after each pattern.
        period_s : float
            Least time in s from one pulse to the next.

        Raises
        ------
        CapabilityError
            The device cannot show them at these times; raised before anything is shown.
        """

    def _follow(self, pulse_s: float) -> None:
        """Show the first loaded pattern with the first pulse at the input, and so on.

        Called by `follow` in IDLE, only where `trigger_inputs` is not 0; override it there. A pattern may be
        shown before its pulse: the first at once, and each next one when a pulse ends. Return once the first
        pulse may come. After the last pattern any may be shown.

        Parameters
        ----------
        pulse_s : float
            Duration of the pulses in s, in which a pattern must be seen whole.

        Raises
        ------
        DeviceError
            It cannot be shown.
        """
        raise NotImplementedError

    @abstractmethod
    def _blank(self) -> None:
        """Go dark, ending a sequence that runs; called by `blank` in IDLE and ARMED.

        Raises
        ------
        DeviceError
            It may not be dark.
        """


def _immutable_copy(pattern: Pattern) -> Pattern:
    """A copy of the pattern that cannot change; the pattern itself where that cannot either."""
    flags = pattern.image.flags
    if flags.owndata and not flags.writeable:
        return pattern
    image = pattern.image.copy()
    image.flags.writeable = False
    return replace(pattern, image=image)


MAX_REFRESHES = 600  # longest flash in refreshes of the display: 10 s at 60 Hz (chosen)


class FlashingProjector(Projector):
    """A projector that shows a display, refreshed at a rate of its own."""

    @property
    @final
    def refresh_s(self) -> float:
        """Period of the refreshes in s, as the display reports it; known once open."""
        self._need(State.IDLE, State.ARMED, doing="refresh_s")
        with self._guard("refresh_s"):
            return self._refresh_period_s()

    @final
    def flash(self, i: int, refreshes: int) -> None:
        """Show one loaded pattern for some refreshes, with darkness before and after; return when dark.

        Parameters
        ----------
        i : int
            Its index among those loaded.
        refreshes : int
            How many, 1 to `MAX_REFRESHES`.

        Raises
        ------
        SettingError
            No such pattern is loaded, or `refreshes` is out of range.
        """
        self._need(State.IDLE, doing="flash")
        if not 0 <= i < len(self._loaded):
            raise SettingError(
                self.name, "flash", f"pattern {i} was asked for", f"{len(self._loaded)} are loaded"
            )
        if not 1 <= refreshes <= MAX_REFRESHES:
            raise SettingError(self.name, "flash", f"refreshes is {refreshes}", f"1 to {MAX_REFRESHES}")
        with self._guard("flash"):
            self._flash(i, refreshes)

    @abstractmethod
    def _refresh_period_s(self) -> float:
        """Tell the period of the refreshes; called by `refresh_s` in IDLE and ARMED, often: it must be quick.

        Returns
        -------
        float
            The period in s.
        """

    @abstractmethod
    def _flash(self, i: int, refreshes: int) -> None:
        """Show one loaded pattern, dark before and after; called by `flash` in IDLE.

        Parameters
        ----------
        i : int
            Its index among the loaded patterns, from 0.
        refreshes : int
            For how many refreshes, 1 to `MAX_REFRESHES`.

        Raises
        ------
        DeviceError
            It was not shown for exactly that many refreshes.
        """
