"""Taking frames: acquisition with camera and projector synchronised, and checks of the synchronisation."""
