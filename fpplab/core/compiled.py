"""How functions are compiled: kernels, which Python calls, and parts of kernels, which kernels alone call.

Only the ways of calling that are used are compiled: what takes arguments from Python, or hands a function on
as a pointer, takes as long to compile as the function itself.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.extending import register_jitable

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(**options: Any) -> Callable[[_Function], _Function]:
    any_options: Any = njit  # some of which its types leave out
    decorator: Callable[[_Function], _Function] = any_options(cache=True, no_cfunc_wrapper=True, **options)
    return decorator


def kernel_part(**options: Any) -> Callable[[_Function], _Function]:
    """Called from Python, a part runs as Python.

    What a parallel loop itself calls is better a kernel: parts are compiled for the loop and again around it.
    """
    decorator: Callable[[_Function], _Function] = register_jitable(no_cfunc_wrapper=True, **options)
    return decorator
