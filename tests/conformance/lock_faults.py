"""Faults in what keeps processes from each other, and in keys that Windows hands over."""

from __future__ import annotations

from tests.conformance.fault import Fault

LOCK, KEYS = "fpplab/core/lock.py", "fpplab/setup/live/keys.py"
KIND = "fcntl.LOCK_SH if shared else fcntl.LOCK_EX"

LOCKED = [
    Fault("lock: sharing locks out", LOCK, "try_lock", KIND, "fcntl.LOCK_EX"),
    Fault("lock: everybody shares", LOCK, "try_lock", KIND, "fcntl.LOCK_SH"),
    Fault(
        "lock: the first byte is all of it",
        *(LOCK, "_try_bytes", "[(FIRST_BYTE, SHARES)]", "[(FIRST_BYTE, 1)]"),
    ),
    Fault("lock: one shares alone", LOCK, "_try_bytes", "range(SHARES)", "range(1)"),
    Fault(
        "lock: the bytes are the owner's name",
        LOCK,
        "_lock_bytes",
        "os.lseek(handle, first, os.SEEK_SET)",
        "",
    ),
    Fault("lock: the file stays", LOCK, "locked_file", "path.unlink(missing_ok=True)", ""),
    Fault(
        "lock: a deleted file is a lock",
        *(LOCK, "_locked", "if _is_there_still(handle, path):", "if handle:"),
    ),
    Fault(
        "keys: an arrow is two keys",
        *(KEYS, "_by_windows", "if character in PREFIXES:", "if not character:"),
    ),
    Fault("keys: Ctrl-C is a key", KEYS, "_by_windows", "if character == CTRL_C:", "if not character:"),
]
