"""Whether the rig was still as it was characterised when a scan was taken."""

from dataclasses import dataclass


@dataclass(frozen=True)
class GeometryDoubt:
    """Why nobody verified the rig's geometry."""

    reason: str  # as a clause
    remedy: str  # what settles it
    detail: str = ""  # what stands behind the reason


@dataclass(frozen=True)
class SeenChange:
    """A change of the rig since its characterisation that a scan shows."""

    sentence: str
    excess: float  # how many times as great as what is stated
    remedy: str


@dataclass(frozen=True)
class MarksVerdict:
    """Whether reference marks verify a scan's geometry."""

    verified: bool
    change: SeenChange | None = None  # of the rig, where they show one
    doubt: GeometryDoubt | None = None  # where they settle nothing
    is_unexplained: bool = False  # whether they look different in a way that no change of the rig explains


@dataclass(frozen=True)
class GeometryCheck:
    """What is known of the rig's geometry at a scan, beyond what the points show."""

    doubt: GeometryDoubt | None  # None where it was verified within the rig's limits
    hidden: tuple[tuple[str, float], ...] = ()  # what the scan would not show, with its cost in µm
    other_devices: str | None = None  # how these devices are not those of the calibration
    region_is_known: bool = True  # whether images are known to show the calibration's region of the sensor
    change: SeenChange | None = None  # that reference marks show
    seen: bool = False  # whether reference marks show the geometry, which a doubt is then not about

    @property
    def unverified(self) -> tuple[str, ...]:
        """What nothing checked."""
        details = (self.doubt.detail,) if self.doubt and self.doubt.detail else ()
        return (*details, *(f"{what} (points {in_words(um)} off)" for what, um in self.hidden))


def in_words(um: float) -> str:
    """Write a length with two digits."""
    rounded = float(f"{um:.2g}")
    return f"{rounded / 1e3:g} mm" if rounded >= 1e3 else f"{rounded:g} µm"
