"""Controls of a video camera, by the kernel's numbers, and the values at which frames are the sensor's.

Source: Linux, include/uapi/linux/v4l2-controls.h; USB Device Class Definition for Video Devices 1.5, 4.2.2.
"""

from __future__ import annotations

EXPOSURE_MODE, EXPOSURE_100_US, GAIN = 0x009A_0901, 0x009A_0902, 0x0098_0913
MANUAL = 1  # value of `EXPOSURE_MODE` (V4L2_EXPOSURE_MANUAL)

RAW: dict[int, int | None] = {
    EXPOSURE_MODE: MANUAL,
    0x009A_0903: 0,  # frame rate that depends on the exposure
    0x0098_0912: 0,  # automatic gain
    0x0098_0920: 0,  # automatic brightness
    0x0098_0900: None,  # brightness
    0x0098_0901: None,  # contrast
    0x0098_0910: 100,  # gamma, in hundredths
    0x0098_0914: 0,  # mirrored
    0x0098_0915: 0,  # upside down
    0x0098_091B: 0,  # sharpness
    0x0098_091C: 0,  # backlight compensation
    0x009A_0915: 0,  # wide dynamic range
    0x009F_0903: 0,  # test pattern
}
"""Values by control; None is the control's default, where no value is laid down as neutral.

A camera may lack any of them; those that it has must have these values.
"""
