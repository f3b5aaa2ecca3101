"""The projector's flash: pattern images, the firmware file that contains them, and its upload."""
