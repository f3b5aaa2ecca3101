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

    description = describe_session(Session.open(session))
    console.print_result(description, json, lambda: _show(description))


def _show(description: dict[str, Any]) -> None:
    from fpplab.core.units import readable_bytes

    origin = description["origin"] or {}
    size = description["size"]
    devices = origin.get("devices") or {}
    rows = {
        "format": description["format"],
        "frames": f"{description['frames']} of {description['images']}",
        "size": f"{size[0]} x {size[1]} px, {description['bits']} bits" if size else "",
        "rig": "imported images" if description["imported"] else description["rig"],
        "taken": " to ".join(description["taken"]) if description["taken"] else "not recorded",
        "by": f"fpplab {origin['version']} on {origin['host']}" if origin else "not recorded",
        **{name: f"{device['model']} {device['serial']}".strip() for name, device in devices.items()},
        "results": ", ".join(description["results"]) or "none",
        "on disk": readable_bytes(description["bytes"]),
    }
    console.table(description["session"], ["", ""], [[name, value] for name, value in rows.items()])
