"""Threads of the linear algebra that NumPy and SciPy call."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS work on the caller's thread alone, in a `with` block or in a decorated function.

    On the small matrices here its threads gain nothing and wait for each other, spinning; and sums would
    depend on how many processors there are.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
