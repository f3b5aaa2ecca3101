"""The Blender process dies, hangs or is interrupted: no process and no shared memory is left."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, StateError
from fpplab.devices import CameraSettings, State
from fpplab.patterns.fringes import uniform_patterns
from sim.bench import VirtualBench
from sim.build import SceneState, build_scene
from sim.devices import SimCamera, SimFixture, SimProjector
from sim.scene import RenderSettings, SubpixelView
from sim.worker import Blender, missing_library
from tests.sim.conftest import plain, world, write_world

ROOT = Path(__file__).parents[2]


MIDDLE = [SubpixelView((0.0, 0.0))]
"""One ray through the middle of every pixel."""


def soon(condition: Callable[[], bool]) -> bool:
    """Whether a condition becomes true within a time limit."""
    for _ in range(400):
        if condition():
            return True
        time.sleep(0.05)
    return False


def gone(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def shared_memory() -> set[str]:
    """Named memory; semaphores are of others."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith("sem.")}


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.whole
def test_death_in_the_middle_of_a_render_faults_the_camera_until_it_is_reopened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = plain(render={"subpixels": 8, "samples": 64, "bounces": 4})
    before = shared_memory()
    bench = VirtualBench({"world": write_world(tmp_path, data)})
    bench.open()
    with SimProjector("projector", {}, bench) as projector, SimFixture("fixture", {}, bench) as fixture:
        projector.load(uniform_patterns([255], projector.caps.size))
        projector.show(0)
        fixture.mount("pillars")
        camera = SimCamera("camera", {}, bench)
        camera.open()
        camera.configure(CameraSettings(0.02))
        bench.blender.start()
        pid = bench.blender.pid
        assert pid is not None
        send = bench.blender._send

        def send_and_kill(verb: str, content: Any) -> None:
            send(verb, content)
            if verb == "render":
                threading.Timer(0.7, os.kill, (pid, signal.SIGKILL)).start()

        monkeypatch.setattr(bench.blender, "_send", send_and_kill)
        with pytest.raises(DisconnectedError, match=r"Blender process has died.*run the same command again"):
            camera.snap()
        monkeypatch.undo()
        assert camera.state is State.FAULT
        assert gone(pid)
        with pytest.raises(StateError):
            camera.snap()
        camera.close()
        bench.replace_world(world())  # a lighter load, for time's sake
        with camera:
            camera.configure(CameraSettings(0.02))
            assert camera.snap().image.max() > 100
    bench.close()
    assert shared_memory() == before


@pytest.mark.whole
def test_closing_leaves_no_process_memory_or_descriptor(tmp_path: Path) -> None:
    before, memory = descriptors(), shared_memory()
    blender = Blender("bench")
    of = world()
    blender.render(build_scene(of, SceneState("card"))[0], None, MIDDLE, RenderSettings(), 60)
    pid = blender.pid
    assert pid is not None
    blender.close()
    blender.close()
    assert gone(pid)
    assert blender.pid is None
    assert descriptors() == before
    assert shared_memory() == memory


@pytest.mark.whole
def test_what_others_print_in_the_process_is_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("print('hello', end='', flush=True)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    blender = Blender("bench")
    blender.start()
    assert blender.pid is not None
    blender.close()


@pytest.mark.whole
def test_too_slow_a_render_is_ended() -> None:
    blender = Blender("bench")
    of = world(render={"samples": 4096, "bounces": 8, "subpixels": 8})
    scene, _ = build_scene(of, SceneState("pillars"))
    blender.start()
    pid = blender.pid
    with pytest.raises(DeviceTimeoutError, match="did not answer within"):
        blender.render(scene, None, MIDDLE, RenderSettings(4096, 8), 0.3)
    assert pid is not None
    assert gone(pid)
    assert blender.pid is None


@pytest.mark.whole
def test_interruption_ends_the_process_and_the_next_render_starts_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    blender = Blender("bench")
    of = world()
    scene, _ = build_scene(of, SceneState("card"))
    blender.start()
    pid = blender.pid

    def interrupted(timeout_s: float) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(blender._answers, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        blender.render(scene, None, MIDDLE, RenderSettings(), 60)
    assert pid is not None
    assert gone(pid)
    assert blender.render(scene, None, MIDDLE, RenderSettings(), 60).max() > 0
    blender.close()


@pytest.mark.whole
def test_blender_ends_with_the_process_that_started_it() -> None:
    """Killed outright in the middle of a long render, the parent takes Blender with it."""
    script = """
import sys
from sim.build import SceneState, build_scene
from sim.scene import RenderSettings, SubpixelView
from sim.worker import Blender
from tests.sim.conftest import world
blender, of = Blender("bench"), world(render={"subpixels": 8})
scene, _ = build_scene(of, SceneState("pillars"))
blender.start()
print(blender.pid, flush=True)
blender.render(scene, None, [SubpixelView((0.0, 0.0))], RenderSettings(4096, 8), 600)
"""
    before = shared_memory()
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    time.sleep(0.5)
    parent.kill()
    parent.communicate()
    assert soon(lambda: gone(pid))
    assert shared_memory() == before


@pytest.mark.whole
def test_failure_inside_blender_is_reported_and_the_process_lives_on() -> None:
    blender = Blender("bench")
    of = world()
    scene, _ = build_scene(of, SceneState("card"))
    with pytest.raises(DeviceError, match="Blender failed"):
        blender.render(scene, None, MIDDLE, RenderSettings("few"), 60)  # type: ignore[arg-type]
    pid = blender.pid
    assert blender.render(scene, None, MIDDLE, RenderSettings(), 60).max() > 0
    assert blender.pid == pid
    blender.close()


@pytest.mark.parametrize(
    ("library", "package"),
    [("libX11.so.6", "libx11-6"), ("libxkbcommon.so.0", "libxkbcommon0"), ("libGL.so.1", "libgl1")],
)
def test_missing_system_library_names_the_package(library: str, package: str) -> None:
    said = f"ImportError: {library}: cannot open shared object file: No such file or directory"
    found, remedy = missing_library(said) or ("", "")
    assert library in found
    assert remedy == f"run: apt-get install {package}"


def test_blender_that_cannot_start_for_want_of_a_library_says_so_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "python"
    said = "ImportError: libSM.so.6: cannot open shared object file: No such file or directory"
    broken.write_text(f"#!/bin/sh\necho '{said}' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(broken))
    with pytest.raises(DeviceError, match=r"library libSM\.so\.6, which .* apt-get install libsm6$"):
        Blender("bench").start()


def test_only_a_missing_library_is_taken_for_one() -> None:
    assert missing_library("ImportError: No module named bpy") is None
