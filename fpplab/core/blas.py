"""Threads of the linear algebra that NumPy and SciPy call."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def on_one_blas_thread(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Let BLAS work on the caller's thread alone.

    On the small matrices here its threads gain nothing and wait for each other, spinning; and sums would
    depend on how many processors there are.
    """

    @wraps(function)
    def limited(*arguments: _Parameters.args, **options: _Parameters.kwargs) -> _Result:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **options)

    return limited
