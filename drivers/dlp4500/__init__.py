"""The DLP LightCrafter 4500 and its controller, the DLPC350, over USB HID.

`framing` and `protocol` are the packets as pure functions, `transport` matches questions and answers,
`sequence` knows planes and times, `controller` gives the orders, `device` is the projector of a rig.
"""

from drivers.dlp4500.device import Dlp4500

__all__ = ["Dlp4500"]
