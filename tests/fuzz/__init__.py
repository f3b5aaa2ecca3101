"""Fuzzing of what reads files or bytes of others: only typed errors, soon, and in little memory."""
