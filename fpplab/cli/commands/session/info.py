"""`fpplab session info`: what a session is."""

from __future__ import annotations

from typing import Any

from fpplab.cli import console
from fpplab.cli.app import Json
from fpplab.cli.commands.session.group import SessionPath, session_app


@session_app.command("info")
def info_command(session: SessionPath, json: Json = False) -> None:
    """Tell what a session is: format, plan, frames, rig, devices, times and results. Reads no frame.

    Example: `fpplab session info pyramid`
    """
    from fpplab.sessions.inspection import describe_session
    from fpplab.sessions.session import Session

    found = describe_session(Session.open(session))
    console.print_result(found, json, lambda: _show(found))


def _show(found: dict[str, Any]) -> None:
    from fpplab.core.units import readable_bytes

    origin = found["origin"] or {}
    devices = origin.get("devices") or {}
    rows = {
        "format": found["format"],
        "frames": f"{found['frames']} of {found['images']}",
        "size": f"{found['size'][0]} x {found['size'][1]} px, {found['bits']} bits" if found["size"] else "",
        "rig": "imported images" if found["imported"] else found["rig"],
        "taken": " to ".join(found["taken"]) if found["taken"] else "not recorded",
        "by": f"fpplab {origin['version']} on {origin['host']}" if origin else "not recorded",
        **{name: f"{one['model']} {one['serial']}".strip() for name, one in devices.items()},
        "results": ", ".join(found["results"]) or "none",
        "on disk": readable_bytes(found["bytes"]),
    }
    console.table(found["session"], ["", ""], [[name, value] for name, value in rows.items()])
