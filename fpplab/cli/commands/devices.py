"""`fpplab devices`: list what is connected."""

from dataclasses import asdict

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Json, app


@app.command("devices", rich_help_panel=PREPARE)
def devices_command(json: Json = False) -> None:
    """List the cameras, projectors, displays and stages found.

    Says why others are missing. Names a rig file supplied with fpplab for each device that has one; `fpplab
    rig new` writes a rig file.
    """
    from fpplab.devices.discovery import connected_devices

    discovered = connected_devices()
    rows = [asdict(d) for d in discovered.devices]
    shown = [[d.kind, d.model, d.serial, d.link, d.example or "none"] for d in discovered.devices]

    def show() -> None:
        if rows:
            console.table("Devices", ["kind", "model", "serial", "link", "rig file for it"], shown)
            console.log_status(
                "`fpplab rig new --out rig.yaml` writes a rig file with those that you choose."
            )
        else:
            console.log_status(
                "No camera, projector or stage is connected; check power and cables. "
                "Without instruments use `--rig rig_demo_quick`, which is simulated."
            )
        for sentence in discovered.missing:
            console.log_status(f"missing: {sentence}")

    console.print_result({"devices": rows, "missing": discovered.missing}, json, show)
