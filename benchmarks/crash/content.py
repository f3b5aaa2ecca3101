"""What a command left, file by file, without what says when it was made."""

import base64
import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

LOG = "log.jsonl"

TIMES = frozenset({"host_time_s", "device_time_s", "seconds", "made", "poses_taken", "time"})
"""Keys of JSON objects that say when something was made, or how long it took."""
DATE = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?( ?UTC|Z|[+-]\d\d:?\d\d)?)?")
MADE = re.compile(r"^(\s*)(made|poses_taken): .*$", re.MULTILINE)
LINK = re.compile(r"data:(application/json|text/csv)[^,\"]*?(;base64)?,([^\"]*)")
SECONDS = re.compile(r"( ?\b\d+(\.\d+)? (s|min|h|seconds|minutes)\b)+")
IGNORED = re.compile(r"\..*\.lock|" + re.escape(LOG))


def content_of(place: Path) -> dict[str, str]:
    """Give a checksum for every file below a folder, or of one file with those beside it of the same stem."""
    found: dict[str, str] = {}
    for root in sorted(place.parent.glob(f"{place.stem}*")):
        files = sorted(root.rglob("*")) if root.is_dir() else [root]
        for file in files:
            if file.is_file() and not IGNORED.fullmatch(file.name):
                name = str(file.relative_to(place.parent)).replace(place.stem, "OUT", 1)
                found[name] = hashlib.sha256(timeless(file, place.stem)).hexdigest()
    return found


def timeless(file: Path, stem: str) -> bytes:
    """Read a file without what says when, and under which name, it was made."""
    read = READERS.get(file.suffix)
    if read is None:
        return file.read_bytes()
    return re.sub(re.escape(stem), "OUT", read(file.read_text("utf-8")), flags=re.IGNORECASE).encode()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(one) for key, one in value.items() if key not in TIMES}
    if isinstance(value, list):
        return [_without_times(one) for one in value]
    return SECONDS.sub("", DATE.sub("", value)) if isinstance(value, str) else value


def _lines(text: str) -> str:
    return "\n".join(json.dumps(_without_times(json.loads(line))) for line in text.splitlines())


def _yaml(text: str) -> str:
    return MADE.sub("", text)


def _page(text: str) -> str:
    def shown(link: re.Match[str]) -> str:
        raw = base64.b64decode(link[3]) if link[2] else unquote_to_bytes(link[3])
        plain = raw.decode("utf-8")
        return json.dumps(_without_times(json.loads(plain))) if "json" in link[1] else _plain(plain)

    return _plain(LINK.sub(shown, text))


def _plain(text: str) -> str:
    return SECONDS.sub("", DATE.sub("", text))


READERS: dict[str, Callable[[str], str]] = {
    ".jsonl": _lines,
    ".yaml": _yaml,
    ".html": _page,
    ".json": lambda text: json.dumps(_without_times(json.loads(text))),
}
"""How files are read whose text says when they were made; all others have to be the same to the last bit."""
