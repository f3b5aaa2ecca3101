"""Software emulator of the DLPC350, the controller of a LightCrafter 4500.

It covers the controller's commands, its pattern sequencer and its USB interface. Behaviour is that of the
public documentation, apart from what `Dlpc350Policy` names. It serves to test drivers and is no evidence of
how a real board behaves.
"""

from drivers.emulators.dlpc350.engine import STRICT, Dlpc350Policy
from drivers.emulators.dlpc350.firmware import Dlpc350
from drivers.emulators.dlpc350.light import FlashImage, ProjectedLight
from drivers.emulators.dlpc350.loader import FlashedDlpc350
from drivers.emulators.dlpc350.sequencer import Pulse
from drivers.emulators.dlpc350.usb import EmulatedHid, UsbFault
from drivers.emulators.dlpc350.video import EmulatedDisplay, Video

__all__ = [
    "STRICT",
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
