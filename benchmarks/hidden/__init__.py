"""Benches that nobody has seen: worlds with effects that every real bench has, drawn from a seed.

Neither the instrument nor the twin may read this package (an import contract sees to it): what they know of
such a bench is what it recorded.
"""
