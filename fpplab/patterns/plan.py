"""A measurement plan: which patterns are projected and captured, independent of the devices."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import AXES, Axis, axis_length
from fpplab.core.depth import DepthField
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.tagged_union import registered_types
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets import AnySet, FringeSet, PatternSet, indices_along
from fpplab.patterns.fringe_sets.base import ExposureTime
from fpplab.patterns.response import with_named_response
from fpplab.patterns.unwrapping import unwrapping_methods

_log = logging.getLogger(__name__)


def _single_exposure(given: dict[str, Any]) -> float:
    several = sorted(given.get("exposures_s") or [0.02])
    return float(several[len(several) // 2])


def with_named_files(data: Any, folder: Path) -> Any:
    """Put into the raw data of a plan what the files hold that its sets name."""
    sets = data.get("fringes") if isinstance(data, dict) else None
    if not isinstance(sets, list):
        return data
    kinds: dict[str, Any] = registered_types(PatternSet)
    completed = []
    for each in sets:
        kind = kinds.get(str(each.get("kind"))) if isinstance(each, dict) else None
        completed.append(kind.completed(each, folder) if kind else each)
    return {**data, "fringes": completed}


def _known_method(name: str) -> str:
    methods = [f"'{method}'" for method in sorted(unwrapping_methods(), reverse=True)]
    if f"'{name}'" not in methods:
        raise ValueError(f"should be {' or '.join(methods)}")
    return name


class MaskRules(Document):
    """What a pixel must satisfy to be measured.

    Grey levels are of the 8-bit scale. Saturated pixels are never measured.
    """

    modulation_min: Annotated[float, Field(ge=0, le=127)] = 4.0
    """Least fringe amplitude B, in grey levels of 255."""
    contrast_min: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Least B / offset; ambient light and shadow lower it."""
    residual_max: Annotated[float, Field(gt=0)] = 0.25
    """Greatest RMS misfit of the sinusoid as a share of B, besides the harmonics of the response."""
    disagreement_max: Annotated[float, Field(gt=0, le=0.5)] = 0.4
    """Greatest difference between the position that coarser fringes predict and the one that finer fringes
    show, as a share of the finer period; a greater one is accepted where the noise of all sets explains it
    and leaves no doubt of the order.
    """
    wrong_order_max: Annotated[float, Field(gt=0, le=1)] = 1e-4
    """Greatest probability of a wrong fringe order, computed from the noise of all fringe sets; 1 masks none.
    It does not count what is no noise; orders that stray light has changed are left out where neighbours
    show them.
    """


def _zero_or_two(limit: float) -> float:
    """Refuse limits that noise alone exceeds."""
    if 0.0 < limit < 2.0:
        raise ValueError("must be 0, for no limit, or at least 2")
    return limit


class FilterRules(Document):
    """What a measured point must satisfy to be kept (`fpplab.reconstruction.filtering`)."""

    disagreement_max: Annotated[float, Field(ge=0), AfterValidator(_zero_or_two)] = 4.0
    """Greatest disagreement between the fringe sets, in units of what noise explains, at least 2; 0 leaves
    the rule out, where they may disagree as under stray light."""
    light_min: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """Least modulation of a point at an edge, as a share of that of the surface it continues; 0 leaves the
    rule out."""
    flying: bool = True
    """Whether points are removed that are across a jump in depth from most of the pixels around them."""
    patch_min: Annotated[int, Field(ge=1)] = 25
    """Least number of pixels of a connected region of the surface. A normal is computed from 25 pixels."""


class GreyLevels(Document):
    """How the response is measured: with uniform grey-level images from black to white."""

    levels: Annotated[int, Field(ge=5, le=256)] = 16
    """How many grey levels are shown, evenly spaced from 0 to 255."""
    repeats: Annotated[int, Field(ge=1, le=1000)] = 3
    """How many times every level is shown."""

    @property
    def shown(self) -> list[int]:
        """The grey levels, of 255, from black to white."""
        return [round(255 * k / (self.levels - 1)) for k in range(self.levels)]


class StagePosition(Document):
    """Where one of the rig file's further stages stands during a measurement."""

    stage: str
    """Its name in the rig file's `stages`."""
    at: float
    """Its position in mm; of a turning one in degrees."""


class Plan(Document):
    """Sets of patterns in the order they are shown, how to unwrap them, and the exposure."""

    model_config = ConfigDict(serialize_by_alias=True)

    sets: tuple[AnySet, ...] = Field(alias="fringes", min_length=1)
    """The sets of patterns, in the order they are shown: fringes, and codes of other kinds."""
    unwrapping: Annotated[str, AfterValidator(_known_method)] = "hierarchical"
    """Name of the temporal unwrapping method (`fpplab.patterns.unwrapping`)."""
    guided_axis: Axis | None = None
    """The axis of the last fringe set, whose orders come from the calibration and the coordinate along the
    other axis; by default every axis is unwrapped by its own sets.

    Without a calibration there is no coordinate along it, and a characterisation cannot use the plan.
    """
    exposures_s: Annotated[tuple[ExposureTime, ...] | None, Field(min_length=2, max_length=8)] = None
    """Exposures in s of which each takes every pattern, for surfaces of which no exposure suits all; all
    patterns are shown at the first, then at the next. By default `exposure_s` alone.
    """
    exposure_s: ExposureTime = Field(default_factory=_single_exposure)
    """Exposure of every frame, in s; with `exposures_s`, of what takes single pictures, such as `live`."""
    bits: Literal[8, 10, 12, 16] | None = None
    """Depth of the camera's grey levels, which the camera must offer; by default that of the rig file.

    12 bits lessen the error of rounding where little light comes back; their frames take twice the disk and
    the time of the camera's link.
    """
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Wait between showing a pattern and exposing its frame in a stepped plan, in s."""
    trigger: Literal["stepped", "triggered", "followed"] = "stepped"
    """How camera and projector are synchronised: "stepped" shows a pattern and then takes its frame,
    "triggered" has the projector's trigger expose every frame, "followed" has each exposure bring its
    pattern.
    """
    masks: MaskRules = MaskRules()
    """Which pixels are measured."""
    order_vote: dict[Literal["window"], Annotated[int, Field(ge=3, le=51)]] | None = None
    """Side in px of the window of a vote in version 0.1. It is still read, and has no effect: pixels whose
    fringe order is in doubt are left out."""
    filter: FilterRules | None = None
    """Which points are removed as lying on no surface, `{}` for the usual rules; by default none."""
    response: Curve | None = None
    """Patterns are shown through the inverse of this response, so that the light is sinusoidal.

    In a plan file the name of a response file, next to the plan or by path, or its `{a, b, g}`. It is a key
    of the plan and no option of a command, because it is part of what is shown: a scan, its resumption, its
    replay and the search that wrote the plan then cannot differ in it. `Plan.load` puts the values in place
    of the name, so that a session's plan records how its patterns were made.
    """
    greys: GreyLevels = GreyLevels()
    """How the response itself is measured; uniform grey-level images are never corrected."""
    stage_mm: float | None = None
    """Position of the rig's stage during the measurement, in mm; by default the stage is not moved."""
    stages: tuple[StagePosition, ...] | None = None
    """Positions of the rig file's further `stages`, such as a turntable; by default none is moved."""

    depth_mm: DepthField | None = None
    """Least and greatest distance from the camera along its axis, in mm, between which everything lies that
    is seen: with a calibration, only projector coordinates that this allows count. Guided unwrapping needs
    it. By default that of the rig file, if it has one.
    """

    @model_validator(mode="after")
    def _exposures_differ(self) -> Plan:
        for exposures_s in (self.exposures_s or (), *self.exposures_by_set):
            if len(set(exposures_s)) < len(exposures_s):
                raise ValueError("'exposures_s' names an exposure twice")
        if self.has_set_exposures and len(self.fringe_indices) < len(self.sets):
            raise ValueError("'fringes' has a set with 'exposures_s': needs a plan of fringes alone")
        finest = (
            {self.exposures_by_set[self.finest_set(axis)] for axis in self.axes}
            if self.has_set_exposures
            else ()
        )
        if len(finest) > 1:
            raise ValueError("'exposures_s' of the finest sets along x and y must be the same")
        return self

    @model_validator(mode="after")
    def _sizes_agree(self) -> Plan:
        sizes = {each.projector_size for each in self.sets}
        if len(sizes) > 1:
            raise ValueError("every fringe set must name the same projector_size, or none")
        return self

    @model_validator(mode="after")
    def _has_a_code(self) -> Plan:
        if not self.axes:
            raise ValueError("'fringes' have even light alone: needs a set that codes an axis")
        return self

    @model_validator(mode="after")
    def _can_be_guided(self) -> Plan:
        if fault := self.guidance_fault():
            raise ValueError(fault)
        return self

    @model_validator(mode="after")
    def _response_can_be_inverted(self) -> Plan:
        if self.response is not None:
            self.response.check_correctable()
        return self

    def __repr__(self) -> str:
        sets = ", ".join(f"{each.coded_axis or ''} {each.short_name} x {each.images}" for each in self.sets)
        several = f" at {len(self.exposures)} exposures" if self.exposures_s else ""
        return f"<Plan: {sets}; {self.images} images{several}, {self.unwrapping}>"

    @classmethod
    def load(cls, path: Path | str) -> Plan:
        """Read a plan file, by path or by the name of one that comes with fpplab.

        A response file or pattern files that the plan names are read too, and their values are put into it.

        Parameters
        ----------
        path : path or str
            The plan file, or the name of one of fpplab's own plans.

        Returns
        -------
        Plan
            The plan.

        Raises
        ------
        ConfigError
            The plan or its response file is missing or wrong; the message names file, field and what is
            allowed.
        """
        file = config.find_config(path, "plan")
        with naming_other_kinds(file, "plan"):
            data = config.parse_yaml(config.read_text(file), file)
            data = with_named_files(with_named_response(data, file), file.parent)
            plan = config.validate(data, cls, file)
        if plan.order_vote is not None:
            _log.warning("%s: 'order_vote' has no effect any more: pixels in doubt are left out", path)
        return plan

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Plan:
        """Copy with other values, by their names in a plan file; they are not checked."""
        changed = {"sets" if name == "fringes" else name: value for name, value in (update or {}).items()}
        return super().model_copy(update=changed, deep=deep)

    @property
    def fringes(self) -> tuple[FringeSet, ...]:
        """The fringe sets, in the order they are shown; a `ConfigError` where there are other sets.

        `fringe_part` is without them.
        """
        fringes = tuple(each for each in self.sets if isinstance(each, FringeSet))
        if len(fringes) < len(self.sets):
            others = {type(each).__name__.lower() for each in self.sets if not isinstance(each, FringeSet)}
            kinds = ", ".join(sorted(others))
            raise ConfigError(f"the plan has sets that are no fringes ({kinds}), which this cannot use")
        return fringes

    @property
    def fringe_indices(self) -> tuple[int, ...]:
        """Indices into `sets` of the fringe sets."""
        return tuple(k for k, each in enumerate(self.sets) if isinstance(each, FringeSet))

    @property
    def fringe_part(self) -> Plan | None:
        """The plan with its fringe sets alone; None where it has none."""
        fringes = tuple(each for each in self.sets if isinstance(each, FringeSet))
        if len(fringes) == len(self.sets):
            return self
        return self.model_copy(update={"fringes": fringes}) if fringes else None

    @property
    def images(self) -> int:
        """Number of images that are shown."""
        return sum(each.images for each in self.sets)

    @property
    def has_set_exposures(self) -> bool:
        """Whether a set has exposures of its own."""
        return any(isinstance(each, FringeSet) and each.exposures_s for each in self.sets)

    @property
    def exposures_by_set(self) -> tuple[tuple[float, ...], ...]:
        """Exposures in s of each set's images."""
        common = self.exposures_s or (self.exposure_s,)
        return tuple((isinstance(each, FringeSet) and each.exposures_s) or common for each in self.sets)

    @property
    def exposures(self) -> tuple[float, ...]:
        """Exposures in s in the order taken; each takes the images of all sets that have it."""
        return tuple(dict.fromkeys(each for several in self.exposures_by_set for each in several))

    @property
    def passes(self) -> tuple[tuple[int, ...], ...]:
        """The images that each exposure takes, by index."""
        sets = [range(*pair) for pair in pairwise(self.set_starts)]
        return tuple(
            tuple(
                i
                for own, images in zip(self.exposures_by_set, sets, strict=True)
                if each in own
                for i in images
            )
            for each in self.exposures
        )

    @property
    def pass_starts(self) -> tuple[int, ...]:
        """Indices of each exposure's first frame, and of what would follow the last one."""
        return tuple(accumulate((len(images) for images in self.passes), initial=0))

    def part_at(self, exposure_s: float) -> Plan:
        """Give the part of the plan, the sets that have it, that one of `exposures` takes."""
        sets = tuple(
            each for each, own in zip(self.sets, self.exposures_by_set, strict=True) if exposure_s in own
        )
        return self if sets == self.sets else self.model_copy(update={"fringes": sets, "guided_axis": None})

    @property
    def frames(self) -> int:
        """Number of frames of a measurement: every image at each of its exposures."""
        return self.pass_starts[-1]

    def refuse_exposures(self, use: str) -> None:
        """Refuse several exposures where `use`, the subject of the message, needs one: `ConfigError`."""
        if len(self.exposures) > 1:
            raise ConfigError(f"plan: 'exposures_s' has {len(self.exposures)} exposures, but {use} takes one")

    def refuse_set_exposures(self, use: str) -> None:
        """Refuse exposures of single sets where `use`, the subject of the message, needs one for all."""
        if self.has_set_exposures:
            raise ConfigError(
                f"plan: a set has its own 'exposures_s', but {use} takes those of the plan alone"
            )

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes that are coded, x before y."""
        coded = {each.coded_axis for each in self.sets}
        return tuple(a for a in AXES if a in coded)

    @property
    def unwrapped_axes(self) -> tuple[Axis, ...]:
        """The axes that their own sets unwrap, x before y: all but `guided_axis`."""
        return tuple(axis for axis in self.axes if axis != self.guided_axis)

    def guidance_fault(self) -> str | None:
        """Say why the guided axis cannot be guided, also of a copy, which is not checked by itself."""
        axis, last = self.guided_axis, len(self.sets) - 1
        along = tuple(k for k, each in enumerate(self.sets) if each.coded_axis == axis)
        if axis is None or (along == (last,) and last > 0 and isinstance(self.sets[last], FringeSet)):
            return None
        return f"'guided_axis' is '{axis}': needs the last fringe set, and no other, along {axis}"

    def along(self, axis: Axis) -> Plan:
        """Give the part of the plan with the fringe sets along one axis alone."""
        fringes = tuple(fringe for fringe in self.fringes if fringe.axis == axis)
        unwrapping = "guided" if axis == self.guided_axis else self.unwrapping
        return self.model_copy(update={"fringes": fringes, "unwrapping": unwrapping, "guided_axis": None})

    @property
    def projector_size(self) -> tuple[int, int] | None:
        """Projector size (width, height) in px that the fringes were made for; None if not given."""
        return self.sets[0].projector_size

    def sets_along(self, axis: Axis) -> tuple[int, ...]:
        """List the fringe sets along an axis by their indices, fewest stripes first."""
        return indices_along(self.fringes, axis)

    def finest_set(self, axis: Axis | None = None) -> int:
        """Give the index of the set with most stripes along an axis, by default the first that is coded."""
        return self.sets_along(axis or self.axes[0])[-1]

    @property
    def finest(self) -> FringeSet:
        """The finest set along the first coded axis: it gives modulation and the scene's picture."""
        return self.fringes[self.finest_set()]

    @property
    def set_starts(self) -> tuple[int, ...]:
        """Indices of each set's first image, and of what would follow the last set, (S + 1,)."""
        return tuple(accumulate((each.images for each in self.sets), initial=0))

    @property
    def finest_images(self) -> tuple[int, ...]:
        """Indices of the images of the finest set along the first coded axis."""
        first, end = self.set_starts[self.finest_set() :][:2]
        return tuple(range(first, end))

    def steps(self) -> Iterator[tuple[int, int, str]]:
        """Iterate over every image, in the order shown.

        Yields
        ------
        tuple of int, int, str
            Index of the set in `sets`, step within the set, id of the pattern.
        """
        for index, each in enumerate(self.sets):
            for n in range(each.images):
                yield index, n, each.pattern_id(index, n)

    def check_projector(self, size: tuple[int, int], source: Path | str) -> None:
        """Refuse sets that a projector of this size in px cannot show, or that are for another."""
        for i, each in enumerate(self.sets):
            if fault := each.fault(axis_length(size, each.coded_axis or "x")):
                raise ConfigError(f"{source}: 'fringes[{i}].{fault}")
        if self.projector_size not in (None, tuple(size)):
            raise ConfigError(
                f"{source}: 'projector_size' is {list(self.projector_size or ())} but the projector "
                f"has {list(size)} pixels"
            )
