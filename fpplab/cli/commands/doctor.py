"""`fpplab doctor`: whether this computer has what fpplab needs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import Json, app
from fpplab.core.errors import DeviceError

if TYPE_CHECKING:
    from fpplab.core.doctor import DoctorFinding


@app.command("doctor", rich_help_panel="system")
def doctor_command(
    folder: Annotated[
        Path, typer.Argument(help="Folder in which scans will be written.", exists=True, file_okay=False)
    ] = Path(),
    json: Json = False,
) -> None:
    """Check this computer for everything fpplab needs, and say how to correct what is missing.

    Packages and extras, system libraries, permissions of devices and folders, the computer's settings for USB
    and network cameras, graphics processors, the speed of the disk, and all versions. An extra that is not
    installed is not an error; the command to install it is shown. Nothing is sent to a device. The exit code
    is 3 if something has to be corrected.

    Example: `fpplab doctor --json > doctor.json`, to attach to a question
    """
    from fpplab.core import doctor

    with console.progress("Looking"):
        findings = [
            *doctor.check_packages(),
            *doctor.check_libraries(),
            *_permissions(),
            *doctor.check_folders([folder]),
            doctor.check_graphics(),
            doctor.check_disk(folder),
        ]
    versions = doctor.installed_versions()
    wrong = [finding for finding in findings if finding.state == "wrong"]

    def show() -> None:
        rows = [[finding.name, finding.state, finding.seen] for finding in findings]
        console.table(f"fpplab {versions['fpplab']}, Python {versions['python']}", ["", "", ""], rows)
        for finding in findings:
            if finding.remedy:
                console.stdout.print(f"{finding.name}: {finding.remedy}")
        console.stdout.print("All is well." if not wrong else f"To correct: {len(wrong)}.")

    answer = {"ok": not wrong, "checks": [asdict(finding) for finding in findings], "versions": versions}
    console.print_result(answer, json, show)
    if wrong:
        raise console.CommandExit(DeviceError.exit_code)


def _permissions() -> list[DoctorFinding]:
    from fpplab.core.doctor import DoctorFinding
    from fpplab.devices.discovery import COMPUTER, connected_devices

    discovered = connected_devices()
    barred = [
        ("computer" if s.startswith(COMPUTER) else "permissions", *s.removeprefix(COMPUTER).split("; ", 1))
        for s in discovered.missing
        if "may not open" in s or s.startswith(COMPUTER)
    ]
    if not barred:
        return [DoctorFinding("permissions", "ok", f"{len(discovered.devices)} devices seen")]
    return [DoctorFinding(name, "wrong", refusal, remedy) for name, refusal, remedy in barred]
