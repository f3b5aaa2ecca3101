"""Limits of a rig, as far as candidates of a search depend on them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from fpplab.core.conventions import Axis, axis_length
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Seeded, Turnable
from fpplab.optimisation.candidate import Candidate
from fpplab.patterns.fringe_sets import PeriodicSet


@dataclass(frozen=True)
class RigLimits:
    """Limits of a rig."""

    name: str  # name in the rig's file
    size: tuple[int, int]  # width and height of the projector in pixels
    max_patterns: int  # patterns that the projector can hold
    exposure_s: tuple[float, float]  # shortest and longest exposure of the camera
    bit_depths: Mapping[int, float]  # shortest exposure of the projector by the bits of its patterns
    dead_time_s: float  # time between two exposures in seconds
    stage_mm: tuple[float, float] | None  # travel of the stage in mm; None without a stage
    can_turn_projector: bool  # whether the projector can be rotated, which only a simulation can do
    items: frozenset[str] | None  # what the fixture holds; None where it can be anything
    allows_copies: bool = False  # whether several processes can each open the rig

    @classmethod
    def of(cls, rig: Rig) -> RigLimits:
        projector, camera = rig.projector.caps, rig.camera.caps
        held = rig.need_fixture("a search").caps.items
        return cls(
            name=rig.file.name,
            size=projector.size,
            max_patterns=projector.max_patterns,
            exposure_s=camera.exposure_s,
            bit_depths=projector.bit_depths,
            dead_time_s=camera.readout_s + camera.dark_s,
            stage_mm=rig.stage.caps.travel_mm if rig.stage and rig.stage.caps.unit == "mm" else None,
            can_turn_projector=isinstance(rig.simulation, Turnable),
            items=None if held is None else frozenset(held),
            allows_copies=isinstance(rig.simulation, Seeded),
        )

    def max_stripes(self, axis: Axis, pixels_per_period: float) -> float:
        return axis_length(self.size, axis) / pixels_per_period

    def refusals(self, candidate: Candidate, pixels_per_period: float = 2.0) -> Iterator[str]:
        for i, each in enumerate(candidate.fringes):
            if not isinstance(each, PeriodicSet):
                continue
            max_stripes = self.max_stripes(each.axis, pixels_per_period)
            if each.stripes > max_stripes:
                yield (
                    f"'fringes[{i}].stripes' is {each.stripes:g}: at {pixels_per_period:g} projector "
                    f"pixels per period at most {max_stripes:g} along {each.axis}"
                )
        if candidate.images > self.max_patterns:
            yield f"{candidate.images} images: the projector holds at most {self.max_patterns} patterns"
        yield from self._light_refusals(candidate)
        if candidate.stage_mm is not None:
            yield from self._stage_refusals(candidate.stage_mm)
        if candidate.convergence_deg and not self.can_turn_projector:
            yield f"'convergence_deg' is {candidate.convergence_deg:g}: its projector cannot be turned"

    def _light_refusals(self, candidate: Candidate) -> Iterator[str]:
        bits, (shortest_s, longest_s) = candidate.pattern_bits, self.exposure_s
        if bits not in self.bit_depths:
            yield f"'pattern_bits' is {bits}: its projector shows {sorted(self.bit_depths)}"
            return
        shortest_s = max(shortest_s, self.bit_depths[bits])
        name = "exposures_s" if candidate.exposures_s else "exposure_s"
        for exposure_s in candidate.exposures:
            if not shortest_s <= exposure_s <= longest_s:
                yield (
                    f"'{name}' is {exposure_s:g}: with {bits} bits from {shortest_s:g} s, which is "
                    f"{1.0 / (shortest_s + self.dead_time_s):.4g} images per second, to {longest_s:g} s"
                )

    def _stage_refusals(self, mm: float) -> Iterator[str]:
        if self.stage_mm is None:
            yield f"'stage_mm' is {mm:g}: the rig has no stage"
        elif not self.stage_mm[0] <= mm <= self.stage_mm[1]:
            lower_mm, upper_mm = self.stage_mm
            yield f"'stage_mm' is {mm:g}: the stage travels from {lower_mm:g} to {upper_mm:g} mm"

    def check_items(self, artefacts: Sequence[str], source: str) -> None:
        for name in artefacts:
            if self.items is not None and name not in self.items:
                raise ConfigError(
                    f"{source}: 'artefacts' names '{name}', and the fixture of rig '{self.name}' holds "
                    f"{', '.join(sorted(self.items))}"
                )

    def check(self, candidate: Candidate, source: str) -> None:
        for reason in self.refusals(candidate):
            raise ConfigError(f"{source}: {reason} (rig '{self.name}')")
