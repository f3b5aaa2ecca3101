"""Taking frames: camera and projector synchronised, their times, and the check by frames."""
