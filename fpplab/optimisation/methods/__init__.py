"""Ways to search a space: each a function of a lab, deterministic, that tells why it ended."""
