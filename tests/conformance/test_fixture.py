"""What every fixture holds, and what it refuses."""

import numpy as np
import pytest

from fpplab.core.errors import ConfigError, SettingError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import Fixture, PosableFixture, State
from fpplab.devices.rig import Rig


def test_every_item_can_be_mounted_and_taken_away(fixture: Fixture) -> None:
    for item in fixture.caps.items or ("board", "pyramid"):
        fixture.mount(item)
    fixture.mount("nothing")
    assert fixture.state is State.IDLE


def test_an_unknown_item_is_refused(fixture: Fixture) -> None:
    if fixture.caps.items is None:
        fixture.check("philosopher's stone")
        return
    with pytest.raises(SettingError, match="has no item 'philosopher's stone'"):
        fixture.mount("philosopher's stone")
    assert fixture.state is State.IDLE


def test_a_pose_that_it_has_not_is_refused(fixture: Fixture) -> None:
    for item, poses in (fixture.caps.items or {"board": None}).items():
        for pose in (-1, *([] if poses is None else [poses])):
            with pytest.raises(SettingError, match=f"{item} has no pose {pose}"):
                fixture.mount(item, pose)
        if poses:
            fixture.mount(item, poses - 1)
    assert fixture.state is State.IDLE


def test_a_rig_says_when_it_has_no_fixture(rig: Rig) -> None:
    if rig.fixture is not None:
        assert rig.need_fixture("this test") is rig.fixture
    else:
        with pytest.raises(ConfigError, match="'fixture' is missing, and this test needs one"):
            rig.need_fixture("this test")


def test_a_fixture_that_can_be_told_a_pose_takes_its_own_and_refuses_others(fixture: Fixture) -> None:
    if not isinstance(fixture, PosableFixture):
        return
    with pytest.raises(SettingError, match="has no item 'philosopher's stone'"):
        fixture.place("philosopher's stone", RigidTransform.identity())
    for item in fixture.caps.items or {}:
        held = fixture.pose(item)
        if held is None:  # an emulated bench whose optics have fixed poses
            with pytest.raises(SettingError, match="fixed poses alone"):
                fixture.place(item, RigidTransform.identity())
            continue
        fixture.place(item, held)
        with pytest.raises(SettingError):
            fixture.place(item, held.moved(np.array([0.0, 0.0, -1e4])))
        fixture.mount(item)
    assert fixture.state is State.IDLE
