"""Software emulators of the devices at the far end of the drivers' connections, for tests and training."""
