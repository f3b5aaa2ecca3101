"""The projector's flash: pattern images, the firmware file that holds them, and its upload."""
