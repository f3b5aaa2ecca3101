"""A rig that stays open and is served to other programs: orders in a queue, and what became of them."""
