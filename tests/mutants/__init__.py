"""Mutation test of the suite: faults that are listed or drawn at random, seeded one at a time."""
