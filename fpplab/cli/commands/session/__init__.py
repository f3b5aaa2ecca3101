"""`fpplab session info|verify|repair`: what a session is, whether it is whole, and what can be kept of it."""

from fpplab.cli.commands.session import info, repair, verify

__all__ = ["info", "repair", "verify"]
