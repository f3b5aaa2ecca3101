"""Set-up at the bench: what the camera sees, frame by frame, with focus, exposure, overlap and coverage."""
