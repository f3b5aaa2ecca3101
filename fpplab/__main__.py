"""The program `fpplab`, and `python -m fpplab`."""

import os
import sys


def forget_working_directory() -> None:
    """Take the working directory from Python's path of modules, unless the program itself lies there."""
    # `python -m` puts it first, so that any file there could pass for a library; processes that are started
    # later do without it too.
    program = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not sys.flags.safe_path and sys.path[:1] == [os.getcwd()] and sys.path[0] != program:
        del sys.path[0]
    sys.path[:] = [place for place in sys.path if place]
    os.environ["PYTHONSAFEPATH"] = "1"


if __name__ == "__main__":
    forget_working_directory()  # before anything else is imported

# Built into Python: to import `signal` takes as long as all that comes before the first signal is heard.
import _signal  # type: ignore[import-not-found] # noqa: E402


def main() -> None:
    """Run the command that `sys.argv` names; an interruption while the program is loaded ends it too."""
    forget_working_directory()
    hear_signals()
    from fpplab.core import interrupts

    interrupts.watch_signals()
    open_standard_streams()
    try:
        from fpplab.cli import main as run

        run()
    except KeyboardInterrupt:
        interrupts.end_on_next_signal()
        os.write(2, b"fpplab: cancelled\n")
        if "--json" in sys.argv:
            os.write(1, b'{"error": "cancelled", "exit_code": 130}\n')
        os._exit(interrupts.CANCELLED)


def hear_signals() -> None:
    """Have an interruption end the process: nothing has begun. Before this Python itself dies of it."""
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")  # the last two of other systems and of Windows
    for number in (getattr(_signal, name) for name in names if hasattr(_signal, name)):
        if _signal.getsignal(number) is not _signal.SIG_IGN:
            _signal.signal(number, lambda *_: os._exit(130))


def open_standard_streams() -> None:
    """Open what was closed by whoever started the program, or files of a scan would get these descriptors."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8"))
    if hasattr(sys.stdout, "reconfigure") and not sys.stdout.encoding.lower().startswith("utf"):
        sys.stdout.reconfigure(errors="replace")  # a code page of Windows lacks signs of help and tables


if __name__ == "__main__":
    main()
