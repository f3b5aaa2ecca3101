"""The geometry of devices and boards, the shape of a bent board, and the pose of the grey card."""
