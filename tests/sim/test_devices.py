"""The four devices over one world."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core.conventions import Image
from fpplab.core.errors import CapabilityError, ConfigError, LimitError, SettingError
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, uniform_patterns
from sim.bench import VirtualBench
from sim.devices import SimCamera, SimStage
from sim.light import SceneState, ShownPattern
from tests.sim.conftest import Bench, plain, world, write_world


def test_frames_show_what_is_on_show(bench: Bench) -> None:
    bench.fixture.mount("card")
    means = []
    for i in range(3):
        bench.projector.show(i)
        frame = bench.camera.snap()
        assert frame.pattern_id is None
        means.append(float(frame.image.mean()))
    bench.projector.blank()
    dark = bench.camera.snap()
    black = 0.01 * 4095
    assert abs(dark.image.mean() - black) < 1
    assert abs(means[0] - black) < 1
    assert abs((means[1] - black) / (means[2] - black) - 128 / 255) < 0.002
    bench.fixture.mount("nothing")
    bench.projector.show(2)
    assert abs(bench.camera.snap().image.mean() - black) < 1


def test_exposure_and_gain_scale_the_signal(bench: Bench) -> None:
    bench.fixture.mount("card")
    bench.projector.show(1)
    means = {}
    for settings in (
        CameraSettings(0.02, bits=12),
        CameraSettings(0.01, bits=12),
        CameraSettings(0.01, 6.0206, 12),
    ):
        bench.camera.configure(settings)
        means[settings.exposure_s, settings.gain_db] = bench.camera.snap().image.mean() - 0.01 * 4095
    full = means[0.02, 0.0]
    assert abs(means[0.01, 0.0] / full - 0.5) < 0.002
    assert abs(means[0.01, 6.0206] / full - 1.0) < 0.002
    bench.camera.configure(CameraSettings(0.02, bits=12))


def test_same_seed_gives_the_same_frames_and_every_frame_its_own_noise(bench: Bench) -> None:
    bench.fixture.mount("card")
    bench.projector.show(1)

    def run() -> list[Image]:
        bench.camera.close()
        bench.camera.open()
        bench.camera.configure(CameraSettings(0.02))
        return [bench.camera.snap().image for _ in range(2)]

    first, second = run(), run()
    np.testing.assert_array_equal(first, second)
    assert (first[0] != first[1]).mean() > 0.1
    bench.camera.configure(CameraSettings(0.02, bits=12))


def test_stage_carries_the_projector_along_the_baseline(bench: Bench) -> None:
    """A lit edge moves on the card as the moved projector's model says."""
    bench.fixture.mount("card")
    edge = np.zeros(bench.projector.caps.size[::-1], np.uint8)
    edge[:, 456:] = 255
    bench.projector.load([Pattern("edge", edge)])
    bench.projector.show(0)
    bench.stage.home()
    of = bench.shared.world
    pose = bench.fixture.pose("card")
    assert pose is not None
    for position in (0.0, -30.0):
        assert bench.stage.move_to(position) == position
        image = bench.camera.snap().image.astype(float)
        row = image[64] > image[64].max() / 2
        column = int(np.argmax(row)) if not row[0] else int(np.argmin(row))
        ray = np.append(of.camera_model().normalise(np.array([column - 0.5, 64.0])), 1.0)
        normal = pose.rotation[:, 2]
        point = ray * (normal @ pose.translation) / (normal @ ray)
        u = of.projector_model().project(point[None], of.T_projector_camera(position))[0, 0]
        # The edge lies between mirrors, at 455.5 or half a mirror on; a camera pixel spans 2 mirrors here.
        assert abs(u - 455.75) < 2.5
    bench.stage.move_to(0.0)
    bench.projector.load(uniform_patterns([0, 128, 255], bench.projector.caps.size))
    with pytest.raises(LimitError):
        bench.stage.move_to(1000.0)


def test_another_world_keeps_the_pictures_that_are_still_valid(bench: Bench) -> None:
    """A changed response or sensor needs no render; a changed pose does."""
    bench.fixture.mount("card")
    bench.projector.show(1)
    before = bench.camera.snap().image.astype(float)
    original, blender = bench.shared.world, bench.shared.blender
    samples = bench.shared.light.table(bench.shared.setup)
    bent = world(projector={**plain()["projector"], "response": {"a": 1.0, "b": 0.0, "g": 2.0}})
    bench.shared.replace_world(bent)
    assert bench.shared.light.table(bench.shared.setup) is samples
    black = 0.01 * 4095
    ratio = (bench.camera.snap().image.mean() - black) / (before.mean() - black)
    assert abs(ratio - 128 / 255) < 0.002
    moved = world(projector={**plain()["projector"], "centre_px": [440.0, 1110.0]})
    bench.shared.replace_world(moved)
    assert bench.shared.light.table(bench.shared.setup) is not samples
    bench.shared.replace_world(original)
    assert bench.shared.blender is blender


def test_projector_shows_what_its_depth_can(bench: Bench) -> None:
    image = np.full(bench.projector.caps.size[::-1], 100, np.uint8)
    shown = bench.projector.load([Pattern("coarse", image, bit_depth=1), Pattern("fine", image)])
    assert [int(p.image[0, 0]) for p in shown] == [0, 100]
    bench.projector.load(uniform_patterns([0, 128, 255], bench.projector.caps.size))


def test_without_a_trigger_output_playing_is_refused(bench: Bench) -> None:
    with pytest.raises(CapabilityError, match="no trigger output"):
        bench.projector.play(0.02)
    with pytest.raises(CapabilityError, match="hardware trigger"):
        bench.camera.arm(1, "hardware")


def test_fixture_lists_items_and_refuses_others(bench: Bench) -> None:
    assert bench.fixture.caps.items == {"card": 1, "pillars": 1, "board": 4}
    with pytest.raises(SettingError, match="has no pose 4"):
        bench.fixture.mount("board", 4)
    with pytest.raises(SettingError, match="has no item 'cup'"):
        bench.fixture.pose("cup")


@pytest.mark.parametrize("still", [False, True])
def test_a_virtual_bench_can_switch_vibration_off_and_use_fewer_subpixels(
    still: bool, tmp_path: Path
) -> None:
    file = write_world(tmp_path, plain(vibration_mm=0.05, render={"subpixels": 3}))
    bench = VirtualBench({"world": file, "analytic": True, "subpixels": 2, "still": still})
    assert bench.world.render.subpixels == 2
    bench.setup = SceneState("board")
    bench.show = ShownPattern(tuple(uniform_patterns([255], bench.world.projector.size)), 0)
    settings = CameraSettings(0.02, bits=12)
    first, again = (bench.irradiance(settings, frame) for frame in range(2))
    assert np.array_equal(first, again) == still


def test_what_devices_say_of_themselves_gives_nothing_of_the_world_away(bench: Bench) -> None:
    """As of instruments: a longer lens and another pose change no serial number."""
    devices = bench.camera, bench.projector
    before = [device.info() for device in devices]
    shared, whole = bench.camera.bench, bench.camera.bench.world
    lens = whole.camera.model_copy(update={"focal_mm": 1.01 * whole.camera.focal_mm})
    throw = whole.projector.model_copy(update={"throw_ratio": 1.01 * whole.projector.throw_ratio})
    shared.world = whole.model_copy(update={"camera": lens, "projector": throw})
    assert [device.info() for device in devices] == before
    shared.world = whole


def test_wrong_options_are_refused(bench: Bench) -> None:
    with pytest.raises(ConfigError, match="'world' is missing"):
        VirtualBench({})
    with pytest.raises(ConfigError, match="unknown key 'wrld'"):
        VirtualBench({"wrld": "x"})
    with pytest.raises(ConfigError, match="no such file"):
        VirtualBench({"world": "nowhere.yaml"})
    with pytest.raises(ConfigError, match="'subpixels'"):
        VirtualBench({"world": "world_demo.yaml", "subpixels": 9})
    with pytest.raises(ConfigError, match=r"needs the bench 'virtual_bench'"):
        SimCamera("camera", {}, None)
    with pytest.raises(ConfigError, match="no option 'serial'"):
        SimStage("stage", {"serial": "1"}, bench.shared)
