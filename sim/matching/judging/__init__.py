"""Whether to believe a matched twin: refusals, verdict, and what twin and bench differ by."""
