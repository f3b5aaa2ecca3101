"""Who holds a locked file: written into it by the process that locks it, for the messages of all others."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from pathlib import Path

from fpplab.core.files import read_bounded
from fpplab.core.strict_json import parse_object

MOST_BYTES = 10_000
"""Of what a process writes about itself."""


def write_lock_owner(handle: int) -> None:
    """Write this process into a file that it has locked.

    Parameters
    ----------
    handle : int
        Descriptor of the file, open for writing.
    """
    owner = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S"),
        "command": " ".join(["fpplab", *sys.argv[1:]])[:200],
    }
    os.ftruncate(handle, 0)
    os.pwrite(handle, json.dumps(owner).encode(), 0)


def lock_owner(lock: Path) -> str:
    """Say who holds a lock; it may not have written its name yet.

    Parameters
    ----------
    lock : Path
        The file.

    Returns
    -------
    str
        The process in words.
    """
    try:
        found = parse_object(read_bounded(lock, MOST_BYTES))
        return "process {pid} on {host} ('{command}', since {since})".format(**found)
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
