"""Mutation test of the whole suite: faults seeded on the syntax of the sources, one at a time."""
