"""One process at a time writes into a session."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from fpplab.core.errors import DataError
from fpplab.core.files import writing
from fpplab.core.lock import lock_owner, locked_file
from fpplab.sessions.log import end_session_log

_held: dict[Path, int] = {}
"""How many parts of this process hold each lock: a scan holds it while it acquires, and then reconstructs."""


@contextmanager
def exclusive_write(path: Path) -> Iterator[None]:
    # The lock is a file next to the session, `.NAME.lock`, which the system unlocks when its process ends,
    # however it does; a session that is replaced keeps its lock. It names the process that holds it.
    place = path.resolve()
    if place in _held:
        _held[place] += 1
        try:
            yield
        finally:
            _held[place] -= 1
        return
    lock = place.with_name(f".{place.name}.lock")
    made = [folder for folder in place.parents if not folder.exists()]
    with ExitStack() as stack:
        stack.callback(_remove_empty, made)  # last of all
        with writing(path):
            lock.parent.mkdir(parents=True, exist_ok=True)
            if not stack.enter_context(locked_file(lock)):
                problem = f"{lock_owner(lock)} is writing into it"
                raise DataError(f"{path}: {problem}; wait until that is done, or name another output")
        _held[place] = 1
        stack.callback(_held.pop, place)
        stack.push(partial(end_session_log, place))
        yield


def _remove_empty(folders: list[Path]) -> None:
    with suppress(OSError):  # the first that holds something
        for folder in folders:
            folder.rmdir()
