"""An interrupted scan of the twin, completed by another process, is the undisturbed one to the last bit."""

from pathlib import Path

import pytest

from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.sessions.origin import session_origin
from fpplab.sessions.session import Session

RIG = """name: twin
bench: {backend: "sim.devices:VirtualBench", world: world_demo.yaml, binning: 8, analytic: true}
camera: {backend: "sim.devices:SimCamera", bits: 8}
projector: {backend: "sim.devices:SimProjector"}
fixture: {backend: "sim.devices:SimFixture"}
"""
PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4), Sinusoid(axis="x", stripes=8, steps=3)))
POSES = ("pose_00", "pose_01", "pose_02")


class StoppedError(Exception):
    """The process is killed here."""


def run(rig_file: Path, folder: Path, stop: tuple[int, int] | None = None) -> None:
    """Take three poses in one process; stopped at a pose after some of its frames."""
    with Rig.load(rig_file) as rig:
        for pose, name in enumerate(POSES):
            left = [stop[1]] if stop is not None and stop[0] == pose else []

            def observe(frame: Frame, left: list[int] = left) -> None:
                left[:] = [n - 1 for n in left]
                if left and left[0] <= 0:
                    raise StoppedError

            take_or_resume_session(
                rig, PLAN, folder / name, ("board", pose), accept_complete=True, observe_frame=observe
            )


def frames(folder: Path) -> dict[str, bytes]:
    return {f"{path.parent.parent.name}/{path.name}": path.read_bytes() for path in folder.glob("*/frames/*")}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    folder = tmp_path_factory.mktemp("twin")
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    run(folder / "rig.yaml", folder / "whole")
    return folder / "rig.yaml", frames(folder / "whole")


@pytest.mark.whole
@pytest.mark.parametrize("stops", [[(0, 1)], [(1, 3)], [(0, 1), (1, 2), (2, 1)]])
def test_a_resumed_series_is_the_undisturbed_one(
    undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path, stops: list[tuple[int, int]]
) -> None:
    rig_file, expected = undisturbed
    for stop in stops:
        with pytest.raises(StoppedError):
            run(rig_file, tmp_path, stop)
    run(rig_file, tmp_path)
    assert frames(tmp_path) == expected
    assert len(set(expected.values())) == len(expected), "two frames have the same noise"


def test_sessions_in_one_process_have_noise_of_their_own(
    undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path
) -> None:
    with Rig.load(undisturbed[0]) as rig:
        taken = [take_or_resume_session(rig, PLAN, tmp_path / name, ("board", 0)) for name in POSES[:2]]
    origins = [session_origin(session.path) for session in taken]
    assert [origin.first_frame for origin in origins if origin is not None] == [0, PLAN.images]
    again = [Session.open(session.path).stack() for session in taken]
    assert all((a != b).any() for a, b in zip(*again, strict=True))
