"""The DLPC350 of a LightCrafter 4500 in software: its commands, its sequencer, and its end of the USB wire.

Documented behaviour, apart from what `Dlpc350Policy` names; it proves drivers, it is no evidence about a board.
"""

from drivers.emulators.dlpc350.firmware import Dlpc350
from drivers.emulators.dlpc350.light import FlashImage, ProjectedLight
from drivers.emulators.dlpc350.loader import FlashedDlpc350
from drivers.emulators.dlpc350.policy import Dlpc350Policy
from drivers.emulators.dlpc350.sequencer import Pulse
from drivers.emulators.dlpc350.usb import EmulatedHid, UsbFault
from drivers.emulators.dlpc350.video import EmulatedDisplay, Video

__all__ = [
    "Dlpc350",
    "Dlpc350Policy",
    "EmulatedDisplay",
    "EmulatedHid",
    "FlashImage",
    "FlashedDlpc350",
    "ProjectedLight",
    "Pulse",
    "UsbFault",
    "Video",
]
