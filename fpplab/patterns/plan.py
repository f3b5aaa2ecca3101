"""A plan: what to project and capture, and nothing about devices."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Axis, axis_length
from fpplab.core.errors import ConfigError
from fpplab.core.kinds import ByKind
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.response import Curve, Response
from fpplab.patterns.unwrapping import unwrapping_methods

AnyFringeSet = Annotated[FringeSet, ByKind(default="sinusoid")]
"""A fringe set of any kind; a sinusoid where no `kind` is given."""


def _known_method(name: str) -> str:
    known = [f"'{method}'" for method in sorted(unwrapping_methods(), reverse=True)]
    if f"'{name}'" not in known:
        raise ValueError(f"should be {' or '.join(known)}")
    return name


class MaskRules(Document):
    """What a pixel must satisfy to be measured; grey levels are of the 8-bit scale.

    modulation_min: least fringe amplitude B, in grey levels of 255.
    contrast_min: least B / offset; ambient light and shadow lower it.
    residual_max: greatest RMS misfit of the sinusoid as a share of B.
    disagreement_max: greatest difference between the position that coarser fringes
        predict and the one that finer fringes show, as a share of the finer period.
    Saturated pixels are never measured.
    """

    modulation_min: Annotated[float, Field(ge=0, le=127)] = 4.0
    contrast_min: Annotated[float, Field(ge=0, le=1)] = 0.1
    residual_max: Annotated[float, Field(gt=0)] = 0.25
    disagreement_max: Annotated[float, Field(gt=0, le=0.5)] = 0.4


class FilterRules(Document):
    """What a measured point must satisfy to be kept (`fpplab.reconstruction.filtering`).

    disagreement_max: greatest contradiction between the fringe sets, in units of what noise explains.
    light_min: least modulation of a point at an edge, as a share of that of the surface it continues.
    patch_min: least number of pixels that a surface hangs together over. 25 are what a normal is taken from.
    """

    disagreement_max: Annotated[float, Field(ge=2)] = 4.0
    light_min: Annotated[float, Field(ge=0, lt=1)] = 0.9
    patch_min: Annotated[int, Field(ge=1)] = 25


class OrderVote(Document):
    """Repair of fringe orders by local majority, for coarse fringes biased by stray light.

    window: side in camera pixels of the square whose pixels vote, odd.
    """

    window: Annotated[int, Field(ge=3, le=51)] = 7

    @model_validator(mode="after")
    def _odd(self) -> OrderVote:
        if self.window % 2 == 0:
            raise ValueError(f"'window' is {self.window}: must be odd, so that it has a centre")
        return self


class GreyLevels(Document):
    """How the response is measured: `levels` uniform greys from black to white, `repeats` times."""

    levels: Annotated[int, Field(ge=5, le=256)] = 16
    repeats: Annotated[int, Field(ge=1, le=1000)] = 3

    @property
    def shown(self) -> list[int]:
        """The greys, of 255, from black to white."""
        return [round(255 * k / (self.levels - 1)) for k in range(self.levels)]


class Plan(Document):
    """Fringe sets in the order they are shown, how to unwrap them, and the exposure.

    response: patterns are shown through its inverse, so that the LIGHT is sinusoidal. In a plan file the name
    of a response file, beside the plan or by path, or its `{a, b, g}`. It is a key of the plan and no option
    of a command, because it is part of what is shown: a scan, its resumption, its replay and the
    search that wrote the plan then cannot differ in it. `load` puts the values in place of the
    name, so that a session's plan says by itself how its patterns were made.
    filter: which points are removed as lying on no surface, `{}` for the usual rules; by default none.
    greys: how the response itself is measured; uniform greys are never corrected.
    stage_mm: where the rig's stage stands meanwhile; by default where it is.
    """

    fringes: Annotated[tuple[AnyFringeSet, ...], Field(min_length=1)]
    unwrapping: Annotated[str, AfterValidator(_known_method)] = "hierarchical"
    exposure_s: Annotated[float, Field(gt=0, le=60)] = 0.02
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    trigger: Literal["stepped", "triggered"] = "stepped"
    masks: MaskRules = MaskRules()
    order_vote: OrderVote | None = None
    filter: FilterRules | None = None
    response: Curve | None = None
    greys: GreyLevels = GreyLevels()
    stage_mm: float | None = None

    @model_validator(mode="after")
    def _sizes_agree(self) -> Plan:
        sizes = {f.projector_size for f in self.fringes}
        if len(sizes) > 1:
            raise ValueError("every fringe set must name the same projector_size, or none")
        return self

    @model_validator(mode="after")
    def _response_can_be_inverted(self) -> Plan:
        if self.response is not None:
            self.response.check_correctable()
        return self

    @classmethod
    def load(cls, path: Path | str) -> Plan:
        """Read a plan file, by path or by the name of one that comes with fpplab."""
        found = config.find_config(path)
        data = config.parse_yaml(config.read_text(found), found)
        if isinstance(data, dict) and isinstance(data.get("response"), str):
            data = {**data, "response": _named_response(data["response"], found)}
        return config.validate(data, cls, found)

    @property
    def images(self) -> int:
        """How many images a measurement takes."""
        return sum(f.images for f in self.fringes)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes that are coded, x before y."""
        coded = {f.axis for f in self.fringes}
        return tuple(a for a in ("x", "y") if a in coded)

    @property
    def projector_size(self) -> tuple[int, int] | None:
        """The projector that the fringes were made for, where the plan says so."""
        return self.fringes[0].projector_size

    def sets_along(self, axis: Axis) -> tuple[int, ...]:
        """Indices into `fringes` of the sets along one axis, fewest stripes first."""
        chosen = [i for i, f in enumerate(self.fringes) if f.axis == axis]
        return tuple(sorted(chosen, key=lambda i: self.fringes[i].stripes))

    def finest_set(self, axis: Axis | None = None) -> int:
        """Find the finest set, the one with the most stripes.

        Parameters
        ----------
        axis : str, optional
            Along which axis; by default the first that is coded, x before y.

        Returns
        -------
        int
            Index into `fringes`.
        """
        return self.sets_along(axis or self.axes[0])[-1]

    @property
    def finest(self) -> FringeSet:
        """The finest set along the first coded axis: it gives modulation, sigma and the scene's picture."""
        return self.fringes[self.finest_set()]

    @property
    def set_starts(self) -> tuple[int, ...]:
        """Indices of each set's first image, and of what would follow the last set, (S + 1,)."""
        return tuple(accumulate((f.images for f in self.fringes), initial=0))

    @property
    def finest_images(self) -> tuple[int, ...]:
        """Indices of the images of the finest set along the first coded axis."""
        first, end = self.set_starts[self.finest_set() :][:2]
        return tuple(range(first, end))

    def steps(self) -> Iterator[tuple[int, int, str]]:
        """(fringe set, step, pattern id) of every image, in the order shown."""
        for index, fringe in enumerate(self.fringes):
            for n in range(fringe.images):
                yield index, n, fringe.pattern_id(index, n)

    def check_projector(self, size: tuple[int, int], source: Path | str) -> None:
        """Refuse stripes that the projector cannot resolve: `ConfigError`."""
        for i, fringe in enumerate(self.fringes):
            length = axis_length(size, fringe.axis)
            if fringe.stripes > length / 2:
                raise ConfigError(
                    f"{source}: 'fringes[{i}].stripes' is {fringe.stripes:g}: more than half of the "
                    f"projector's {length} pixels along {fringe.axis}; at most {length / 2:g}"
                )
        if self.projector_size not in (None, tuple(size)):
            raise ConfigError(
                f"{source}: 'projector_size' is {list(self.projector_size or ())} but the projector "
                f"has {list(size)} pixels"
            )


def _named_response(name: str, plan: Path) -> dict[str, float]:
    """The law in a response file that a plan names. Raises `ConfigError`."""
    file = Path(config.resolve_beside(name, plan.parent))
    try:
        curve = Response.load(file).curve(file)
    except ConfigError as error:
        raise ConfigError(
            f"{plan}: 'response' must name a file written by `fpplab gamma`: {error}"
        ) from error
    return curve.model_dump()
