"""What stands before the bench: the board's sheet, surroundings, and parts with their surfaces."""
