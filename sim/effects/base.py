"""The base class of all effects."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Document
from fpplab.core.conventions import Floats, Lattice
from sim.effects.step import MatchedParameters, ParametersT, StepContext
from sim.parameter_entry import SubstituteNumber
from sim.scene import PointLamp

FieldsT_co = TypeVar("FieldsT_co", bound=Document, covariant=True)


class EffectCamera(Protocol):
    """What effects read of a world's camera."""

    @property
    def binning(self) -> int:
        """Pixels of the sensor that make one of the frame, along each axis."""


class EffectProjector(Protocol):
    """What effects read of a world's projector besides their own fields."""

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) of mirrors."""

    @property
    def lattice(self) -> Lattice:
        """How the mirrors are arranged."""

    @property
    def distance_mm(self) -> float:
        """Distance at which a white surface that faces the projector has irradiance 1, in mm."""


class EffectWorld(Protocol):
    """What effects read of a world besides their own fields."""

    @property
    def seed(self) -> int:
        """Of random numbers."""

    @property
    def camera(self) -> EffectCamera:
        """Sensor, shutter and lens."""

    @property
    def projector(self) -> EffectProjector:
        """Mirrors, lamp and lens."""

    @property
    def has_room_light(self) -> bool:
        """Whether there is light that is not the projector's."""


@dataclass(frozen=True)
class FrameOfSequence:
    """A frame whose light an effect may change."""

    number: int  # of the frame
    sequence: tuple[int, ...] = ()  # numbers of the sequence that it belongs to; none on a bench


@dataclass(frozen=True)
class LightChange:
    """Factors on the light of one frame."""

    projector: float = 1.0
    room: Floats | float = 1.0  # of the room's even light: one factor, or (R,) one for each row
    lamps: Floats | float | None = None  # of the room's lamps; None: as `room`


class Effect(ABC, Generic[FieldsT_co]):
    """Something that real benches have beyond ideal devices: base class of the effects of the twin.

    A subclass lies in a module of its own in this package, which is found by listing. It owns all there is of
    its effect: fields of world files, parameters that a matching may change, what it does to a frame, how it
    is matched to a bench, and its names in reports. Nothing else has to name it. It is generic in the model
    of its fields, which it reads by `own`.

    A parameter is a field of a frozen dataclass with `sim.parameter_entry.table_entry` as metadata, which
    states the path in the world file. All effects are called one after another by `order`.

    Examples
    --------
    A slow drift of the projector's light::

        class DriftField(Document):
            drift: float = 0.0

        @dataclass(frozen=True, eq=False, kw_only=True)
        class DriftParameter:
            projector_drift: float = field(
                default=0.0, metadata=table_entry("Change per frame, relative.", "projector.drift")
            )

        class Drift(Effect[DriftField]):
            name = "drift"
            explains = "light of the projector that changes slowly"
            order = 100
            parameters = DriftParameter
            strength = ("projector_drift",)
            projector_fields = DriftField
            is_matched = False

            def clear(self, data):
                data["projector"]["drift"] = 0.0

            def changes_light(self, world):
                return self.own(world.projector).drift != 0

            def light_change(self, world, frame, rows, random):
                return LightChange(projector=1.0 + self.own(world.projector).drift * frame.number)
    """

    name: ClassVar[str]  # of its step in records and reports
    explains: ClassVar[str]  # what it is, for reports
    # Place among the effects: in files, of its step, and of the random numbers that it draws. A new effect
    # takes one above all others, so that frames of existing worlds stay as they are.
    order: ClassVar[int]
    parameters: ClassVar[type[Any]]  # frozen dataclass of its parameters
    strength: ClassVar[tuple[str, ...]]  # parameters that are all 0 in a twin without the effect
    world_fields: type[FieldsT_co] | None = None  # model of the fields that a world file has for it
    projector_fields: type[FieldsT_co] | None = None  # the same of the section `projector` of a world file
    fitted: ClassVar[tuple[str, ...]] = ()  # numbers fitted again with all others that expected images show
    # Numbers that are fitted in place of a parameter, such as its inverse
    adjustable: ClassVar[Mapping[str, SubstituteNumber]] = MappingProxyType({})
    is_room_light: ClassVar[bool] = False  # whether it is light that is not the projector's
    is_matched: ClassVar[bool] = True  # whether a matching looks for it by `propose`
    # Whether it differs from frame to frame or pose to pose around one mean: no expected image shows it then
    varies: ClassVar[bool] = False
    characterises: ClassVar[bool] = False  # whether the twin's frames are characterised again after its step

    def own(self, section: EffectWorld | EffectProjector) -> FieldsT_co:
        """Give the effect's own fields of a world, or of its section `projector`."""
        kind = self.world_fields or self.projector_fields
        assert kind is not None
        assert isinstance(section, kind)
        return section

    @abstractmethod
    def clear(self, data: dict[str, Any]) -> None:
        """Take the effect out of a world's plain data, in place; its parameters are then written into it."""

    def mirror_light(self, projector: EffectProjector) -> NDArray[np.float32] | None:
        """Compute factors (rows, columns) on the light of each mirror in every frame; None for 1."""
        return None

    def point_lamps(self, world: EffectWorld) -> tuple[PointLamp, ...]:
        """Place lamps in the room, in the camera's frame, whose light falls on everything in view."""
        return ()

    def displacement_size_mm(self, world: EffectWorld) -> float:
        """Return the RMS size of `displacement_mm`; 0 where the item stands still."""
        # Pictures are computed at this distance, and those of other displacements to first order.
        return 0.0

    def displacement_mm(
        self, world: EffectWorld, frame: FrameOfSequence, random: np.random.Generator
    ) -> Floats:
        """Compute by how much (3,) in mm, along the camera's axes, the item is displaced in one frame."""
        # The displacements of all effects are added, which share `random` in their order. The world need not
        # have the effect.
        return np.zeros(3)

    def point_errors_px(self, world: EffectWorld) -> Floats | None:
        """Return how large the errors of a board's points are; None for no errors."""
        # returns (2, 2) standard deviations in camera and projector, in px of each: of single points, and of
        # the smooth functions over the board that the points of a pose share
        return None

    def changes_light(self, world: EffectWorld) -> bool:
        """Return whether light changes by this effect; without any that does `light_change` is not called."""
        return False

    def light_change(
        self, world: EffectWorld, frame: FrameOfSequence, rows: NDArray[np.intp], random: np.random.Generator
    ) -> LightChange:
        """Compute factors on the light of one frame, in rows (R,); those of all effects are multiplied."""
        # `random` is of this frame, and shared by all effects in their order: draw as many values whatever
        # the world says, which need not have the effect, so that effects do not change each other's.
        return LightChange()

    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        """Fit the effect to what was recorded of a bench, as its step of a matching: parameters to try."""
        # The step is kept where it does not raise `misfit`, or without one the loss.
        return at.parameters

    def misfit(self, at: StepContext[ParametersT]) -> float | None:
        """Compute what the step is judged by, the less the better; None where the loss decides."""
        # such as Schwarz's criterion
        return None

    def is_in(self, parameters: MatchedParameters) -> bool:
        """Return whether a twin has the effect."""
        return any(np.any(getattr(parameters, name)) for name in self.strength)

    def without(self, parameters: ParametersT) -> ParametersT:
        """Give the parameters of a twin without the effect."""
        absent = {known.name: 0.0 for known in fields(self.parameters) if known.default is MISSING}
        return parameters.with_effect(self.parameters(**absent))
