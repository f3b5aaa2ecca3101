"""A rig that stays open is opened again where it has to be, and says so."""

import os
from pathlib import Path

import pytest
import yaml

from fpplab import Instrument
from fpplab.calibration.model import Calibration
from fpplab.core.config import find_config
from fpplab.core.errors import DeviceError
from fpplab.results.observer import Observer
from sim.world.world import World


class Messages(Observer):
    """Keeps what the operator is told."""

    def __init__(self) -> None:
        self.sentences: list[str] = []

    def message(self, sentence: str) -> None:
        self.sentences.append(sentence)


@pytest.mark.whole
def test_a_rig_is_opened_again_after_a_fault_and_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = yaml.safe_load(find_config("rig_demo_quick", "rig").read_text())
    rig["bench"] |= {"world": "world.yaml", "analytic": True}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    world = tmp_path / "world.yaml"
    world.write_text(find_config("world_demo", "world").read_text())
    of = World.load("world_demo").binned(8)
    devices = of.camera_model(), of.projector_model(), of.T_projector_camera()
    rms_px = {"camera": 0.05, "projector": 0.05, "joint": 0.05}
    Calibration(*devices, rms_px=rms_px).save(tmp_path / "calibration.yaml")
    told = Messages()

    def measure() -> bytes:
        scan = bench.scan("plan_nine_images", mount=("board", 0), report=False, observer=told)
        return (scan.session.path / "cloud.ply").read_bytes()

    def torn(*_: object) -> None:
        raise OSError("the cable is torn")

    with Instrument.open(tmp_path / "rig.yaml", folder=tmp_path) as bench:
        first, rig_before = measure(), bench.rig
        with monkeypatch.context() as patch:
            patch.setattr(type(bench.rig.camera), "_read", torn)
            with pytest.raises(DeviceError, match="the cable is torn"):
                measure()
        assert told.sentences == []
        assert measure() == first
        assert bench.rig is not rig_before
        os.utime(world, ns=(0, 0))
        assert measure() == first
    assert [sentence.partition(": ")[2] for sentence in told.sentences] == [
        "a device failed; the rig is opened again",
        "the file, or one that it names, has changed; the rig is opened again",
    ]
