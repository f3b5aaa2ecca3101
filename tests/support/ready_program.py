"""A process that has loaded the program and forks for each command, so that commands of tests start at once.

Loading takes seconds, and the suite runs some thousand commands. A command that is run in another environment
than the suite's own gets a process of its own, for modules may read the environment while they are loaded.
"""

import atexit
import gc
import importlib
import json
import os
import pkgutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import IO, Any

import typer
import typer.main
import typer.testing

UNKNOWN_SHELL = "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"
"""Variable that gives the commands other options."""
READ_LATE = {
    "COMP_CWORD",
    "COMP_WORDS",
    "DISPLAY",
    "FPPLAB_ALLOW_BACKEND",
    "HOME",
    "KMP_DUPLICATE_LIB_OK",
    "LD_LIBRARY_PATH",
    "PYLON_CAMEMU",
    "PYSDL2_DLL_PATH",
    "PYTEST_CURRENT_TEST",
    "WAYLAND_DISPLAY",
    "XDG_CACHE_HOME",
    "_FPPLAB_COMPLETE",
    UNKNOWN_SHELL,
}
"""Variables that no module reads while it is loaded, or that OpenCV, SDL and others set then."""
NOT_LOADED = ("fpplab.__main__", "fpplab.viewer.process")
"""Programs of their own."""
LONGEST_REQUEST = 1 << 20


def reuse_commands() -> None:
    """Have a program's commands built from their functions once, which takes fpplab's a tenth of a second."""
    build = typer.main.get_command
    built = cache(build)

    def command_of(program: typer.Typer) -> Any:
        return (build if UNKNOWN_SHELL in os.environ else built)(program)

    for module, name in ((typer.main, "get_command"), (typer.testing, "_get_command")):
        setattr(module, name, command_of)


class ReadyProgram:
    """The process, started when it is first needed.

    Parameters
    ----------
    folder : Path
        The checkout.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = _at_loading(os.environ)
        self._ours: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def fits(self, environment: dict[str, str]) -> bool:
        """Tell whether a command in this environment would have loaded its modules alike."""
        return sys.platform == "linux" and _at_loading(environment) == self._environment

    def run(
        self,
        words: list[str],
        cwd: Path,
        environment: dict[str, str],
        timeout_s: float,
        begun: Callable[[int], object] = bool,
    ) -> subprocess.CompletedProcess[str]:
        """Run `fpplab WORDS` in a process forked for it; `subprocess.run` with the output captured.

        `begun` is told the number of the process.
        """
        connection = self._connection()
        with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
            request = json.dumps([["fpplab", *words], str(cwd), environment]).encode()
            socket.send_fds(connection, [request], [out.fileno(), err.fileno()])
            connection.settimeout(timeout_s)
            try:
                begun(int(connection.recv(64)))
                answer = connection.recv(64)
            except TimeoutError:
                answer = b""
            if not answer:
                self.close()
                raise RuntimeError(f"fpplab {' '.join(words)}: no end after {timeout_s:g} s. {_text(err)}")
            return subprocess.CompletedProcess(words, int(answer), _text(out), _text(err))

    def close(self) -> None:
        """End the process, and the command that it runs."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        if self._ours is not None:
            self._ours.close()
        self._process = self._ours = None

    def _connection(self) -> socket.socket:
        if self._ours is None:
            self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "tests.support.ready_program", str(theirs.fileno())],
                    cwd=self._folder, env=self._environment, pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL, start_new_session=True,
                )  # fmt: skip
        return self._ours


def _at_loading(environment: Any) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name not in READ_LATE}


def _text(file: IO[str]) -> str:
    file.seek(0)
    return file.read()


def _modules() -> Iterator[str]:
    import fpplab

    for found in pkgutil.walk_packages(fpplab.__path__, "fpplab."):
        if found.name not in NOT_LOADED:
            yield found.name
    yield "sim.devices"  # of the rigs that most tests open


def _prepare_numba() -> None:
    """Load what the first call of a compiled function loads."""
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


def _serve(connection: socket.socket) -> None:
    """Fork for each request and answer with the exit code; returns in the forked process alone."""
    while True:
        request, files, _, _ = socket.recv_fds(connection, LONGEST_REQUEST, 2)
        if not request:
            os._exit(0)
        child = os.fork()
        if not child:
            _become(*json.loads(request), files)
            return
        for file in files:
            os.close(file)
        connection.send(str(child).encode())
        _, status = os.waitpid(child, 0)
        connection.send(str(os.waitstatus_to_exitcode(status)).encode())


def _become(words: list[str], cwd: str, environment: dict[str, str], files: list[int]) -> None:
    for number, file in zip((1, 2), files, strict=True):
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    sys.argv[:] = words


def main() -> None:
    """Load the program, then run commands until the connection is closed."""
    connection = socket.socket(fileno=int(sys.argv[1]))
    connection.set_inheritable(False)
    # `-m` put the folder first; a program that is run has it nowhere, unless PYTHONPATH names it
    sys.path[:] = [*sys.path[1:], os.getcwd()]
    for name in _modules():
        importlib.import_module(name)
    _prepare_numba()
    reuse_commands()
    typer.main.get_command(importlib.import_module("fpplab.cli").app)
    from fpplab.__main__ import main as program

    # What the command spawns asks the main module for its name, and does not run it again if it is fpplab's.
    sys.modules["__main__"].__spec__ = importlib.import_module(program.__module__).__spec__
    assert threading.active_count() == 1, "a process with threads cannot be forked"
    gc.collect()
    gc.freeze()
    _serve(connection)
    connection.close()
    os._exit(_exit_code_of(program))


def _exit_code_of(program: Callable[[], None]) -> int:
    """Run the program as the interpreter would, without taking all that was loaded apart at the end."""
    code: Any = 0
    try:
        program()
    except SystemExit as left:
        code = left.code
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
        code = 1
    if isinstance(code, str):
        print(code, file=sys.stderr)
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, which an exit function may need ended
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code or 0


if __name__ == "__main__":
    main()
