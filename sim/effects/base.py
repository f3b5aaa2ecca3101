"""The base class of all effects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Document
from fpplab.core.conventions import Floats

if TYPE_CHECKING:
    from sim.matching.steps import MatchingContext
    from sim.parameters import TwinParameters
    from sim.world import World


@dataclass(frozen=True)
class FrameOfSequence:
    """A frame whose light an effect may change."""

    number: int  # of the frame
    rows: NDArray[np.intp]  # (R,) of the image
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

            def light_change(self, world, frame, random):
                return LightChange(projector=1.0 + world.projector.drift * frame.number)
    """

    name: ClassVar[str]
    explains: ClassVar[str]
    order: ClassVar[int]
    parameters: ClassVar[type[Any]]
    strength: ClassVar[tuple[str, ...]]
    world_fields: ClassVar[type[Document] | None] = None
    projector_fields: ClassVar[type[Document] | None] = None
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

    def changes_light(self, world: World) -> bool:
        """Tell whether frames of a world have light that changes by this effect.

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

    def light_change(self, world: World, frame: FrameOfSequence, random: np.random.Generator) -> LightChange:
        """Compute what the effect does to the light of one frame.

        Parameters
        ----------
        world : World
            The simulated world, which need not have the effect.
        frame : FrameOfSequence
            The frame and its rows.
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
        """Tell whether a twin has the effect."""
        return any(np.any(getattr(parameters, name)) for name in self.strength)

    def without(self, parameters: TwinParameters) -> TwinParameters:
        """Give the parameters of a twin without the effect."""
        absent: dict[str, Any] = {
            known.name: 0.0 if known.default is MISSING else known.default
            for known in fields(self.parameters)
        }
        return replace(parameters, **absent)
