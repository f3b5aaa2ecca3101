"""Every conformance test runs on every rig; what a rig has is read from its file and its devices.

A test asks for `rig` (open, idle and dark), for one device of it, or for `device`: each device
of each rig in turn.
"""

import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from fpplab.acquisition.acquire import acquire
from fpplab.core import config
from fpplab.core.errors import DeviceError
from fpplab.devices import Camera, Device, Fixture, Projector, Stage, State
from fpplab.devices.rig import Rig, RigFile
from fpplab.sessions.session import Session
from tests.conformance.bench import devices_of, dim_plan
from tests.conformance.dlp4500 import FLASH, flash

RIGS = Path(__file__).parent / "rigs"
RECORDED = RIGS / "rig_reference.yaml"
ON_X_SERVER = "rig_display"
QUICK_RIGS = ("rig_reference", "rig_simulated", "rig_pylon")
"""The reference, the simulation, and a driver on an emulator; quick tests of tests/drivers try the others."""
KINDS = ("camera", "projector", "stage", "fixture")
CAPS_OF_CAMERA = "test_camera.py", "test_caps_make_sense"
"""The test that comes first on each rig: the others use what the camera says of itself."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    wanted = [kind for kind in KINDS if kind in metafunc.fixturenames]
    files = [path for path in _rig_files(metafunc.config) if all(kind in _kinds(path) for kind in wanted)]
    if "device" in metafunc.fixturenames:
        pairs = [(path, kind) for path in files for kind in _kinds(path) if kind in _judged(path)]
        given = [pytest.param(p, k, marks=_marks(p), id=f"{p.stem}-{k}") for p, k in pairs]
        metafunc.parametrize(("opened", "kind"), given, indirect=["opened"], scope="session")
    elif "opened" in metafunc.fixturenames:
        files = [path for path in files if not wanted or any(kind in _judged(path) for kind in wanted)]
        given = [pytest.param(p, marks=_marks(p), id=p.stem) for p in files]
        metafunc.parametrize("opened", given, indirect=True, scope="session")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep to the rigs that were named, and begin on each with what its camera says of itself."""
    if config.getoption("--rig") and not config.getoption("--own-devices"):
        left_out = [one for one in items if RIGS.parent in one.path.parents and _rig_of(one) is None]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
            items[:] = [one for one in items if one not in left_out]
    caps = {_rig_of(one): one for one in items if (one.path.name, _name_of(one)) == CAPS_OF_CAMERA}
    ordered: list[pytest.Item] = []
    for item in items:
        rig = _rig_of(item)
        if rig is not None and rig in caps:
            ordered.append(caps.pop(rig))
        ordered.append(item)
    items[:] = list(dict.fromkeys(ordered))


def _rig_of(item: pytest.Item) -> Path | None:
    """The rig file that a test runs on; None where it brings devices of its own, or no rig has its device."""
    found = item.callspec.params.get("opened") if hasattr(item, "callspec") else None
    return found if isinstance(found, Path) else None


def _name_of(item: pytest.Item) -> str:
    return item.originalname if isinstance(item, pytest.Function) else item.name


def _judged(path: Path) -> tuple[str, ...]:
    """The kinds of devices that are on trial on a rig: not a camera that only serves its projector."""
    return ("projector",) if path.stem == ON_X_SERVER else KINDS


def _marks(path: Path) -> tuple[pytest.MarkDecorator, ...]:
    return (pytest.mark.whole,) if path.parent == RIGS and path.stem not in QUICK_RIGS else ()


def _rig_files(settings: pytest.Config) -> list[Path]:
    named = [Path(name).resolve() for name in settings.getoption("--rig")]
    return named or sorted(RIGS.glob("rig_*.yaml"))


@cache
def _kinds(path: Path) -> list[str]:
    file = config.load_document(path, RigFile)
    return [kind for kind in KINDS if getattr(file, kind) is not None]


@pytest.fixture(scope="session")
def rigs_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig files, with the recording and the index of a flash that two of them need beside them."""
    folder = tmp_path_factory.mktemp("conformance") / "rigs"
    shutil.copytree(RIGS, folder)
    (folder / FLASH).write_text(config.dump(flash()[1]), encoding="utf-8")
    with Rig.load(RECORDED) as rig:
        plan = dim_plan(rig)
        acquire(rig, plan, Session.create(folder / "recording", plan, rig.described()))
    return folder


@pytest.fixture(scope="session")
def opened(request: pytest.FixtureRequest, rigs_folder: Path) -> Iterator[Rig]:
    """A rig that stays open for all its tests: some take long to open."""
    path: Path = request.param
    with Rig.load(rigs_folder / path.name if path.parent == RIGS else path) as rig:
        _stop_at_impossible_capabilities(request.session, rig.camera)
        yield rig


def _stop_at_impossible_capabilities(session: pytest.Session, camera: Camera) -> None:
    """End the run at once: every other test uses what the camera says of itself, such as its exposures."""
    try:
        _ = camera.caps
    except DeviceError as error:
        session.shouldfail = str(error)
        pytest.fail(str(error), pytrace=False)


@pytest.fixture
def rig(opened: Rig) -> Rig:
    """The rig as a test may expect it: freshly opened devices, dark, with something to look at."""
    for device in devices_of(opened):
        device.close()
        device.open()
    if opened.fixture is not None:
        opened.fixture.mount(next(iter(opened.fixture.caps.items or {"board": None})))
    return opened


@pytest.fixture
def device(rig: Rig, kind: str) -> Device:
    found: Device = getattr(rig, kind)
    assert found.state is State.IDLE
    return found


@pytest.fixture
def camera(rig: Rig) -> Camera:
    """The camera, configured as the rig file says."""
    rig.camera.configure(rig.camera_settings(dim_plan(rig).exposure_s))
    return rig.camera


@pytest.fixture
def projector(rig: Rig) -> Projector:
    return rig.projector


@pytest.fixture
def stage(rig: Rig) -> Stage:
    assert rig.stage is not None
    return rig.stage


@pytest.fixture
def fixture(rig: Rig) -> Fixture:
    assert rig.fixture is not None
    return rig.fixture
