"""A fixture that is a person, asked at the terminal: `{backend: "fpplab.devices.operator:Operator"}`."""

import sys
from pathlib import Path

from fpplab.core.errors import DeviceError
from fpplab.devices import DeviceInfo, FixtureCaps, InstructableFixture


class Operator(InstructableFixture):
    """Asks on stderr and waits for Enter on stdin."""

    def _open(self) -> None:
        if not sys.stdin.isatty():
            raise DeviceError(
                self.name, "open", "there is nobody at the terminal", "run this command in a terminal"
            )

    def _close(self) -> None:
        """A person needs no closing."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("fixture", "operator", "", "terminal")

    def _caps(self) -> FixtureCaps:
        return FixtureCaps()

    def _mount(self, item: str, pose: int) -> None:
        item_in_pose = f"Put {item} in front of the rig, as pose {pose}"
        self._wait_for_answer("mount", "Take everything away" if item == "nothing" else item_in_pose)

    def _instruct(self, item: str, description: str, picture: Path | None) -> None:
        shown = f" (see {picture})" if picture else ""
        self._wait_for_answer("instruct", f"Hold {item} {description}{shown}")

    def _wait_for_answer(self, doing: str, ask: str) -> None:
        sys.stderr.write(f"{ask}, then press Enter: ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise DeviceError(self.name, doing, "the terminal was closed", "run the command again")
