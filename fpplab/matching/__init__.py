"""A twin <- a bench: its parameters found from what the bench has recorded."""
