"""Whether the rig was still as it was characterised when a scan was taken."""

from __future__ import annotations

from dataclasses import dataclass

WAY_OUT = (
    "let a new pose of the board confirm the calibration ('fpplab characterise --judge CALIBRATION POSE "
    "--confirm'), and state in the rig file for how many hours the rig keeps its geometry ('geometry: "
    "{max_age_h: 8}')"
)
"""What settles it."""


@dataclass(frozen=True)
class GeometryCheck:
    """What is known of the rig's geometry at a scan, beyond what the points show."""

    doubt: str | None  # why nobody verified it; None where it was verified within the rig's limits
    hidden: tuple[tuple[str, float], ...] = ()  # what the scan would not show, with its cost in µm
    other_devices: str | None = None  # how these devices are not those of the calibration
    region_is_known: bool = (
        True  # whether the images are known to show the calibration's region of the sensor
    )

    @property
    def reason(self) -> str:
        """Why the points are unverified, and what settles it."""
        example = f" ({self.unverified[0]})" if self.unverified else ""
        return f"nothing verified that the rig is as it was characterised{example}: {self.doubt}; {WAY_OUT}"

    @property
    def unverified(self) -> tuple[str, ...]:
        """What nothing checked."""
        return tuple(f"with {what}, points would be {_size(um)} off" for what, um in self.hidden)


def _size(um: float) -> str:
    rounded = float(f"{um:.2g}")
    return f"{rounded / 1e3:g} mm" if rounded >= 1e3 else f"{rounded:g} µm"
