"""Attacks by strangers: every one is refused, soon, and in little memory."""
