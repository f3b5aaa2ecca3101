"""Settings of a Linux computer that keep devices from working, each named only where it is seen to."""

import re
from dataclasses import dataclass
from pathlib import Path

from fpplab.devices.discovery import COMPUTER


@dataclass(frozen=True)
class SettingLimits:
    """Values below which a setting counts as too small."""

    usbfs_bytes: int = 200 << 20  # of all USB transfers (chosen; camera makers advise 1000 MB, Linux has 16)
    socket_bytes: int = 2 << 20  # received by one socket (Basler's advice for its GigE cameras)


LIMITS = SettingLimits()
PROC, SYS = Path("/proc"), Path("/sys")
UDEV_RULES = (Path("/usr/lib/udev/rules.d"), Path("/lib/udev/rules.d"), Path("/etc/udev/rules.d"))


def usb_memory() -> str | None:
    """Describe USB memory that is too small; for a computer with a USB 3 camera."""
    allowed_mb = _number(SYS / "module/usbcore/parameters/usbfs_memory_mb")
    if not allowed_mb or allowed_mb << 20 >= LIMITS.usbfs_bytes:  # 0 is no limit
        return None
    return (
        f"{COMPUTER}USB transfers may have {allowed_mb} MB of memory in all (usbfs_memory_mb), and frames of "
        "a USB 3 camera need more; sudo sh -c 'echo 1000 > /sys/module/usbcore/parameters/usbfs_memory_mb'"
    )


def filtered_packets() -> str | None:
    """Describe packets that reverse-path filtering has dropped; a camera is not listed then."""
    dropped = _counted(PROC / "net/netstat", "TcpExt", "IPReversePathFilter")
    interfaces = PROC / "sys/net/ipv4/conf"
    strict = [f.parent.name for f in sorted(interfaces.glob("*/rp_filter")) if _number(f) == 1]
    if not (dropped and strict):
        return None
    return (
        f"{COMPUTER}{dropped} network packets were dropped by reverse-path filtering (rp_filter is 1 for "
        f"{', '.join(strict)}), as those of a camera in another subnet are; give camera and port addresses "
        "of one subnet, or set rp_filter to 2 (sudo sysctl -w net.ipv4.conf.all.rp_filter=2)"
    )


def full_sockets() -> str | None:
    """Describe datagrams that no socket had room for; for a computer with a network camera."""
    dropped = _counted(PROC / "net/snmp", "Udp", "RcvbufErrors")
    allowed = _number(PROC / "sys/net/core/rmem_max")
    if not dropped or not allowed or allowed >= LIMITS.socket_bytes:
        return None
    return (
        f"{COMPUTER}{dropped} datagrams were dropped because a socket's memory was full, of at most "
        f"{allowed} bytes (rmem_max), and frames of a network camera are damaged so; "
        "sudo sysctl -w net.core.rmem_max=2097152"
    )


def cause_in_settings(usb: bool, ethernet: bool) -> tuple[str, str] | None:
    """Describe what of this computer loses frames of a camera on such a link, and the remedy."""
    sentence = usb_memory() if usb else full_sockets() if ethernet else None
    return None if sentence is None else sentence.removeprefix(COMPUTER).partition("; ")[::2]


def claims_of_brltty(vendor: int, product: int) -> bool:
    """Tell whether the rules of brltty, a program for braille displays, take a serial adapter away."""
    ids = f"{vendor:x}/{product:x}/"
    return any(
        ids in file.read_text(encoding="utf-8", errors="replace").lower()
        for folder in UDEV_RULES
        for file in folder.glob("*brltty*.rules")
    )


def _number(file: Path) -> int | None:
    try:
        return int(file.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _counted(file: Path, group: str, name: str) -> int:
    """Read one counter of the network's statistics, which have a line of names before that of numbers."""
    try:
        text = file.read_text(encoding="ascii")
    except OSError:
        return 0
    lines = [line.split() for line in re.findall(rf"^{group}: .*$", text, re.MULTILINE)]
    return int(dict(zip(*lines, strict=True)).get(name, 0)) if len(lines) == 2 else 0
