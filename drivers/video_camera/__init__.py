"""Driver of UVC and other video cameras that Linux offers as /dev/video…, where their frames are raw.

It has been tested on an emulated USB camera behind the kernel's own UVC driver, not on a real camera;
docs/hardware.md lists what to check when one is first connected.
"""

from drivers.video_camera.camera import VideoCamera

__all__ = ["VideoCamera"]
