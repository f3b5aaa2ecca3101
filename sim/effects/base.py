"""The base class of all effects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from sim.parameter_entry import AdjustableParameter

if TYPE_CHECKING:
    from sim.matching.steps import MatchingContext
    from sim.parameters import TwinParameters
    from sim.scene import PointLamp
    from sim.world import ProjectorWorld, World


@dataclass(frozen=True)
class FrameOfSequence:
    """A frame whose light an effect may change."""

    number: int  # of the frame
    sequence: tuple[int, ...] = ()  # numbers of the sequence that it belongs to; none on a bench


@dataclass(frozen=True)
class LightChange:
    """Factors on the light of one frame."""

    projector: float = 1.0
    room: Floats | float = 1.0  # of all other light: one factor, or (R,) one for each row


class Effect(ABC):
    """Something that real benches have beyond ideal devices: base class of the effects of the twin.

    A subclass lies in a module of its own in this package, which is found by listing. It owns all there is of
    its effect: fields of world files, parameters that a matching may change, what it does to a frame, how it
    is matched to a bench, and its names in reports. Nothing else has to name it.

    A parameter is a field of a frozen dataclass with `sim.parameter_entry.table_entry` as metadata, which
    states the path in the world file. All effects are called one after another by `order`.

    Attributes
    ----------
    name : str
        Of its step in records and reports.
    explains : str
        What it is, for reports.
    order : int
        Place among the effects: in files, of its step, and of the random numbers that it draws. A new effect
        takes one above all others, so that frames of existing worlds stay as they are.
    parameters : type
        Frozen dataclass of its parameters.
    strength : tuple of str
        Parameters that are all 0 in a twin without the effect.
    world_fields : type of Document, optional
        Model of the fields that a world file has for it.
    projector_fields : type of Document, optional
        Model of the fields that the section `projector` of a world file has for it.
    fitted : tuple of str
        Numbers that are fitted again together with all others that expected images show.
    adjustable : mapping of str to AdjustableParameter
        Numbers that are fitted in place of a parameter, such as its inverse.
    is_room_light : bool
        Whether it is light that is not the projector's.
    is_matched : bool
        Whether a matching looks for it by `propose`.
    varies : bool
        Whether it differs from frame to frame around the same mean, so that no expected image shows it.

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

        class Drift(Effect):
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
                return world.projector.drift != 0

            def light_change(self, world, frame, rows, random):
                return LightChange(projector=1.0 + world.projector.drift * frame.number)
    """

    name: ClassVar[str]
    explains: ClassVar[str]
    order: ClassVar[int]
    parameters: ClassVar[type[Any]]
    strength: ClassVar[tuple[str, ...]]
    world_fields: ClassVar[type[Document] | None] = None
    projector_fields: ClassVar[type[Document] | None] = None
    fitted: ClassVar[tuple[str, ...]] = ()
    adjustable: ClassVar[Mapping[str, AdjustableParameter]] = MappingProxyType({})
    is_room_light: ClassVar[bool] = False
    is_matched: ClassVar[bool] = True
    varies: ClassVar[bool] = False

    @abstractmethod
    def clear(self, data: dict[str, Any]) -> None:
        """Take the effect out of a world; its parameters are then written into it.

        Parameters
        ----------
        data : dict
            Plain data of a world, changed in place.
        """

    def mirror_light(self, projector: ProjectorWorld) -> NDArray[np.float32] | None:
        """Compute how much light each mirror of the projector gets, in every frame.

        Parameters
        ----------
        projector : ProjectorWorld
            The simulated projector.

        Returns
        -------
        numpy.ndarray or None
            (rows, columns) factors; None for 1 everywhere.
        """
        return None

    def point_lamps(self, world: World) -> tuple[PointLamp, ...]:
        """Place lamps in the room, whose light falls on everything in view.

        Parameters
        ----------
        world : World
            The simulated world.

        Returns
        -------
        tuple of PointLamp
            In the camera's frame.
        """
        return ()

    def displacement_size_mm(self, world: World) -> float:
        """Return how far the effect displaces the item.

        Parameters
        ----------
        world : World
            The simulated world.

        Returns
        -------
        float
            RMS size of `displacement_mm`; 0 where the item stands still. Pictures are computed at this
            distance, and those of other displacements to first order.
        """
        return 0.0

    def displacement_mm(self, world: World, frame: FrameOfSequence, random: np.random.Generator) -> Floats:
        """Compute by how much the item is displaced in one frame.

        Parameters
        ----------
        world : World
            The simulated world, which need not have the effect.
        frame : FrameOfSequence
            The frame.
        random : numpy.random.Generator
            Shared by all effects in their order.

        Returns
        -------
        numpy.ndarray
            (3,) in mm along the camera's axes, added to that of the other effects.
        """
        return np.zeros(3)

    def changes_light(self, world: World) -> bool:
        """Return whether frames of a world have light that changes by this effect.

        Parameters
        ----------
        world : World
            The simulated world.

        Returns
        -------
        bool
            Where no effect of a world has any, `light_change` is not called.
        """
        return False

    def light_change(
        self, world: World, frame: FrameOfSequence, rows: NDArray[np.intp], random: np.random.Generator
    ) -> LightChange:
        """Compute what the effect does to the light of one frame.

        Parameters
        ----------
        world : World
            The simulated world, which need not have the effect.
        frame : FrameOfSequence
            The frame.
        rows : numpy.ndarray
            (R,) rows of the image that are wanted.
        random : numpy.random.Generator
            Of this frame, shared by all effects in their order. Draw the same number of values whatever the
            world says, so that effects do not change each other's.

        Returns
        -------
        LightChange
            Factors, which are multiplied with those of the other effects.
        """
        return LightChange()

    def propose(self, at: MatchingContext) -> TwinParameters:
        """Fit the effect to what was recorded of a bench: its step of a matching.

        Parameters
        ----------
        at : MatchingContext
            Recordings, the twin so far, and the fits that steps may use.

        Returns
        -------
        TwinParameters
            To try. The step is kept where it does not raise `misfit`, or without one the loss.
        """
        return at.twin.parameters

    def misfit(self, at: MatchingContext) -> float | None:
        """Compute what the step is judged by.

        Parameters
        ----------
        at : MatchingContext
            Recordings and a twin, before the step or after it.

        Returns
        -------
        float or None
            Less is better, such as Schwarz's criterion; None where the loss decides.
        """
        return None

    def is_in(self, parameters: TwinParameters) -> bool:
        """Return whether a twin has the effect."""
        return any(np.any(getattr(parameters, name)) for name in self.strength)

    def without(self, parameters: TwinParameters) -> TwinParameters:
        """Give the parameters of a twin without the effect."""
        absent: dict[str, Any] = {
            known.name: 0.0 if known.default is MISSING else known.default
            for known in fields(self.parameters)
        }
        return replace(parameters, **absent)
