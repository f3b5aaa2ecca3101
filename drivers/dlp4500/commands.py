"""`fpplab dlp4500`: commands for the LightCrafter 4500 itself."""

from drivers.dlp4500 import bench_commands, flash_commands
from drivers.dlp4500.program import dlp4500

__all__ = ["bench_commands", "dlp4500", "flash_commands"]
