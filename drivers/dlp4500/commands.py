"""`fpplab dlp4500`: commands for the LightCrafter 4500 itself."""

from drivers.dlp4500 import flash_commands
from drivers.dlp4500.bench_commands import dlp4500

__all__ = ["dlp4500", "flash_commands"]
