"""`fpplab devices`: list what is connected."""

from __future__ import annotations

from dataclasses import asdict

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Json, app
from fpplab.core import plugins


@app.command("devices", rich_help_panel=PREPARE)
def devices_command(json: Json = False) -> None:
    """List the cameras, projectors and stages that this computer sees, and what keeps others from showing."""
    from fpplab.devices.discovery import FoundDevices

    found = FoundDevices.together(
        plugins.load_plugin(plugins.DISCOVERY, name)() for name in plugins.plugin_names(plugins.DISCOVERY)
    )
    rows = [asdict(d) for d in found.devices]

    def words() -> None:
        if rows:
            console.table("Devices", ["kind", "model", "serial", "link"], [list(d.values()) for d in rows])
        else:
            console.say("No camera, projector or stage is connected; see their power and cables.")
        for sentence in found.missing:
            console.say(f"missing: {sentence}")

    console.answer({"devices": rows, "missing": found.missing}, json, words)
