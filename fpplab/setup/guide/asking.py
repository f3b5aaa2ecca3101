"""How a wanted pose reaches whatever holds the board: a transform for a robot, words for a person."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fpplab.characterisation.guide import WantedPose
from fpplab.core.errors import CapabilityError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import Fixture, InstructableFixture, PosableFixture

Bring = Callable[[WantedPose, Path], None]
"""Brings the board into a wanted pose, which a picture shows."""


def bring_by(fixture: Fixture, item: str) -> Bring:
    """Choose how the fixture is told."""
    if isinstance(fixture, PosableFixture):
        return lambda wanted, _: _place(fixture, item, wanted)
    if isinstance(fixture, InstructableFixture):
        return lambda wanted, picture: fixture.instruct(
            item, wanted.description, picture if picture.is_file() else None
        )
    raise CapabilityError(
        fixture.name,
        "characterise --guide",
        "can neither be told a pose nor be asked in words",
        "leave --guide out, or use 'fpplab.devices.operator:Operator' as the fixture",
    )


def known_first(fixture: Fixture, item: str) -> RigidTransform | None:
    """Tell where the fixture holds the board in the first pose, before the camera can measure it."""
    return fixture.pose(item, 0) if isinstance(fixture, PosableFixture) else None


def _place(fixture: PosableFixture, item: str, wanted: WantedPose) -> None:
    if wanted.T_camera_target is None:  # nothing is known yet: a pose of the fixture's own
        fixture.mount(item, 0)
    else:
        fixture.place(item, wanted.T_camera_target)
