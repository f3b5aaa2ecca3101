"""A good scan: nothing is wrong."""

from bench import show

show()
