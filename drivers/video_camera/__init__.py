"""Driver of UVC and other video cameras that Linux offers as /dev/video…, where their frames are raw."""

from drivers.video_camera.camera import VideoCamera

__all__ = ["VideoCamera"]
