"""What changes from frame to frame: noise, vibration, flicker, bands of room light, motion in a scan."""
