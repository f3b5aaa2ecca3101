"""Writing a rig file: what is chosen, what has to pass, and that nothing is written otherwise."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fpplab.cli.commands import rig as rig_commands
from fpplab.cli.every import app
from fpplab.core import plugins
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError, DeviceError
from fpplab.devices import (
    Camera,
    CameraCaps,
    CameraSettings,
    DeviceInfo,
    Frame,
    Projector,
    ProjectorCaps,
    Stage,
    StageCaps,
    Trigger,
)
from fpplab.devices.discovery import FoundDevice, FoundDevices
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern
from fpplab.setup import new_rig
from fpplab.setup.new_rig import RigDraft, RigSetup

SIZE = (32, 24)


class Light:
    """What the projector gives, how bright the scene is without it, and what was opened and closed."""

    def __init__(self) -> None:
        self.level, self.ambient, self.gain, self.noise = 0.0, 0.1, 1.0, 0.01
        self.log: list[str] = []


LIGHT = Light()


@pytest.fixture(autouse=True)
def light(monkeypatch: pytest.MonkeyPatch) -> Light:
    made = Light()
    monkeypatch.setattr("tests.setup.test_new_rig.LIGHT", made)
    monkeypatch.setattr(new_rig, "LIMITS", new_rig.NewRigLimits(settle_s=0.0))
    return made


class Logged:
    def _open(self) -> None:
        LIGHT.log.append(f"open {self.kind}")  # type: ignore[attr-defined]

    def _close(self) -> None:
        LIGHT.log.append(f"close {self.kind}")  # type: ignore[attr-defined]


class SeeingCamera(Logged, Camera):
    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._serial = options.pop("serial")
        super()._setup(options, shared)

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "seeing", self._serial, "memory")

    def _caps(self) -> CameraCaps:
        return CameraCaps(SIZE, (8, 12), (1e-4, 1.0), (0.0, 12.0), ("software",))

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def _arm(self, n: int, trigger: Trigger) -> None: ...

    def _read(self, timeout_s: float) -> Frame:
        settings = self._configured("read")
        level = LIGHT.gain * (LIGHT.ambient + LIGHT.level) * settings.exposure_s / 0.033
        image = level + np.random.default_rng(1).normal(0.0, LIGHT.noise, SIZE[::-1])
        return Frame(np.asarray(np.clip(255 * image, 0, 255), np.uint8), 0, settings, 0.0)

    def _stop(self) -> None: ...


class LightingProjector(Logged, Projector):
    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._strength = options.pop("strength", 0.5)
        super()._setup(options, shared)

    def _info(self) -> DeviceInfo:
        return DeviceInfo("projector", "lighting", "", "memory")

    def _caps(self) -> ProjectorCaps:
        return ProjectorCaps(SIZE, Lattice.SQUARE, {8: 0.016}, 0, 100)

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._levels = [float(p.image.mean()) / 255.0 for p in patterns]
        return patterns

    def _show(self, i: int) -> None:
        LIGHT.level = self._strength * self._levels[i]

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None: ...

    def _blank(self) -> None:
        LIGHT.level = 0.0


class RailStage(Logged, Stage):
    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._port = options.pop("port")
        super()._setup(options, shared)

    def _info(self) -> DeviceInfo:
        return DeviceInfo("stage", "rail", "", self._port)

    def _caps(self) -> StageCaps:
        return StageCaps((0.0, 100.0))

    def _home(self) -> None:
        LIGHT.log.append("home")

    def _move_to(self, mm: float, deadline_s: float) -> None: ...

    def _position_mm(self) -> float:
        return 0.0

    def _halt(self) -> None: ...


def found(kind: str, serial: str = "", is_certain: bool = True, **options: Any) -> FoundDevice:
    backend = {"camera": "SeeingCamera", "projector": "LightingProjector", "stage": "RailStage"}[kind]
    section = {"backend": f"{__name__}:{backend}", **options}
    if kind == "camera":
        section["serial"] = serial
    return FoundDevice(kind, f"model of {kind}", serial, "memory", section, "", is_certain)


CAMERA, PROJECTOR = found("camera", "A1"), found("projector", "P1")
STAGE = found("stage", is_certain=False, port="/dev/ttyACM0")


def set_up(
    devices: list[FoundDevice],
    folder: Path = Path(),
    ask: Callable[[str, Sequence[str]], int] | None = None,
    home: bool = False,
    told: list[str] | None = None,
    **names: str,
) -> RigDraft:
    sentences = told if told is not None else []
    return RigSetup(FoundDevices(devices, []), names, folder, ask, sentences.append).choose_and_test_devices(
        home, False
    )


def test_the_only_devices_are_taken_tested_and_closed(light: Light, tmp_path: Path) -> None:
    told: list[str] = []
    draft = set_up([CAMERA, PROJECTOR, STAGE], told=told)
    assert set(draft.sections) == {"camera", "projector"}
    assert light.log == ["open camera", "open projector", "close projector", "close camera"]
    assert light.level == 0.0
    seen = draft.summary()
    assert 0.2 < seen["camera"]["most"] < 1.0
    assert seen["projector"]["white"] - seen["projector"]["black"] > 0.2
    assert seen["projector"]["lit"] > 0.5
    assert [line.partition(":")[0] for line in told] == [
        "camera", "camera passed", "projector", "projector passed",
    ]  # fmt: skip
    path = tmp_path / "rig.yaml"
    path.write_text(draft.text("Mine"))
    with Rig.load(path) as rig:
        assert rig.file.name == "Mine"
        assert rig.camera.info().serial == "A1"


def test_a_serial_port_is_used_only_if_it_is_named_and_homed_only_if_told(light: Light) -> None:
    draft = set_up([CAMERA, PROJECTOR, STAGE], stage="/dev/ttyACM0")
    assert draft.sections["stage"]["port"] == "/dev/ttyACM0"
    assert draft.summary()["stage"] == {"homed": False, "travel_mm": (0.0, 100.0)}
    assert "home" not in light.log
    assert set_up([CAMERA, PROJECTOR, STAGE], stage="/dev/ttyACM0", home=True).summary()["stage"]["homed"]
    assert "home" in light.log


def test_several_of_a_kind_must_be_named() -> None:
    devices = [CAMERA, found("camera", "B2"), PROJECTOR]
    with pytest.raises(ConfigError, match=r"several of kind camera; name one with --camera: .*A1.*B2"):
        set_up(devices)
    assert set_up(devices, camera="B2").sections["camera"]["serial"] == "B2"
    with pytest.raises(ConfigError, match=r"--camera is 'C3': no camera has this name; there are .*A1.*B2"):
        set_up(devices, camera="C3")
    with pytest.raises(ConfigError, match=r"--camera is 'model of camera': more than one"):
        set_up(devices, camera="model of camera")


def test_a_device_that_is_missing_is_named() -> None:
    with pytest.raises(DeviceError, match=r"projector: choose: none is connected"):
        set_up([CAMERA, STAGE])
    main = found("projector", "M", is_certain=False)
    with pytest.raises(DeviceError, match=r"none is certain to be one.*name one with --projector"):
        set_up([CAMERA, main])
    assert "projector" in set_up([CAMERA, main], projector="M").sections


def test_a_projector_whose_light_is_not_seen_does_not_pass(light: Light) -> None:
    with pytest.raises(DeviceError, match=r"white brighter than black by .* less than 5 %"):
        set_up([CAMERA, found("projector", strength=0.001)])
    assert light.log[-2:] == ["close projector", "close camera"]


def test_a_camera_that_gives_a_test_image_or_nothing_does_not_pass(light: Light) -> None:
    light.ambient = light.noise = 0.0
    with pytest.raises(DeviceError, match="all pixels are 0, without any noise"):
        set_up([CAMERA, PROJECTOR])
    assert light.log == ["open camera", "close camera"]


@pytest.mark.parametrize("gain", [0.05, 0.3, 6.0, 40.0])
def test_the_exposure_is_fitted_to_the_light(gain: float, light: Light) -> None:
    light.gain = gain
    seen = set_up([CAMERA, PROJECTOR]).summary()
    assert 0.15 < seen["projector"]["white"] < 1.0
    assert seen["camera"]["saturated"] < 0.01


def test_the_operator_chooses_and_may_choose_again(light: Light) -> None:
    asked: list[tuple[str, list[str]]] = []
    answers = iter([1, 0, 0, 1, 0, 1])

    def ask(question: str, given: Sequence[str]) -> int:
        asked.append((question, list(given)))
        return next(answers)

    devices = [CAMERA, found("camera", "B2"), found("projector", strength=0.001), PROJECTOR, STAGE]
    draft = set_up(devices, ask=ask)
    assert [question for question, _ in asked] == [
        "Which camera?",
        "Which projector?",
        "The projector did not pass",
        "Which projector?",
        "Which stage?",
        "Home the stage? Its carriage moves",
    ]
    assert asked[4][1][-1] == "none"
    assert draft.sections["camera"]["serial"] == "B2"
    assert draft.sections["projector"] == dict(PROJECTOR.section)
    assert draft.summary()["stage"]["homed"]


def test_a_backend_of_another_kind_is_refused(light: Light) -> None:
    section = {"backend": PROJECTOR.section["backend"]}
    with pytest.raises(ConfigError, match=r"'camera.backend' is '.*LightingProjector': not a camera"):
        set_up([replace(CAMERA, section=section), PROJECTOR])
    assert light.log == []


def test_the_operator_may_stop() -> None:
    answers = iter([0, 0, 1])
    with pytest.raises(DeviceError, match="white brighter"):
        set_up([CAMERA, found("projector", strength=0.001)], ask=lambda q, a: next(answers))


# --- the command


@pytest.fixture
def connected(monkeypatch: pytest.MonkeyPatch) -> list[FoundDevice]:
    devices = [CAMERA, PROJECTOR, STAGE]
    monkeypatch.setattr(plugins, "plugin_names", lambda group: ["devices"])
    monkeypatch.setattr(plugins, "load_plugin", lambda group, name: lambda: FoundDevices(devices, []))
    return devices


def new(*words: object) -> Any:
    return CliRunner().invoke(app, ["rig", "new", *map(str, words)])


def test_the_command_writes_a_file_that_opens(connected: list[FoundDevice], tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    done = new(
        "--out", path, "--no-questions", "--stage", "/dev/ttyACM0", "--home", "--name", "Mine", "--json"
    )
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert answer["rig"] == str(path)
    assert answer["stage"]["homed"]
    file = Rig.load(path).file
    assert file.name == "Mine"
    assert file.stage is not None
    assert file.fixture is not None
    assert file.fixture.backend == "fpplab.devices.operator:Operator"
    path.unlink()
    assert new("--out", path, "--no-questions", "--no-operator").exit_code == 0
    assert Rig.load(path).file.fixture is None


def test_nothing_is_written_unless_all_pass(connected: list[FoundDevice], tmp_path: Path) -> None:
    connected[1] = found("projector", strength=0.001)
    assert isinstance(new("--out", tmp_path / "rig.yaml", "--no-questions").exception, DeviceError)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_kept_before_any_device_is_opened(
    connected: list[FoundDevice], tmp_path: Path, light: Light
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("mine")
    assert new("--out", path, "--no-questions").exit_code != 0
    assert path.read_text() == "mine"
    assert light.log == []
    assert new("--out", path, "--no-questions", "--force").exit_code == 0
    assert Rig.load(path).file.name == "Bench"


def test_without_a_terminal_it_does_not_wait_for_answers(
    connected: list[FoundDevice], tmp_path: Path, light: Light
) -> None:
    assert "--no-questions" in str(new("--out", tmp_path / "rig.yaml").exception)
    assert isinstance(new("--out", tmp_path / "rig.txt", "--no-questions").exception, ConfigError)
    assert light.log == []


def test_questions_are_asked_until_an_answer_fits(
    connected: list[FoundDevice], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig_commands, "_has_terminal", lambda: True)
    path = tmp_path / "rig.yaml"
    done = CliRunner().invoke(app, ["rig", "new", "--out", str(path)], input="7\n1\n1\n2\n")
    assert done.exit_code == 0, done.output
    assert Rig.load(path).file.stage is None


def test_devices_are_listed_with_the_rig_file_for_them(connected: list[FoundDevice]) -> None:
    connected[1] = FoundDevice("projector", "display 1", "", "1920 x 1080", {}, "rig_display.yaml")
    done = CliRunner().invoke(app, ["devices", "--json"])
    rows = json.loads(done.stdout)["devices"]
    assert rows[1]["example"] == "rig_display.yaml"
    assert rows[0]["section"]["serial"] == "A1"
    assert "rig_display.yaml" in CliRunner().invoke(app, ["devices"], env={"COLUMNS": "200"}).output
