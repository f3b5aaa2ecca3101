"""How functions are compiled: kernels, which Python calls, and parts of kernels, which kernels alone call.

Only the ways of calling that are used are compiled: what takes arguments from Python, or hands a function on
as a pointer, takes as long to compile as the function itself.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _KernelCache(FunctionCache):
    """Loads kernels without what compiling alone needs, and would load first: a quarter of a second."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def kernel(**options: Any) -> Callable[[_Function], _Function]:
    any_options: Any = njit  # some of which its types leave out
    decorator = any_options(cache=True, no_cfunc_wrapper=True, **options)

    def compiled(function: _Function) -> _Function:
        dispatcher: Any = decorator(function)
        if hasattr(dispatcher, "_cache"):  # which a function has not that is left as Python
            dispatcher._cache = _KernelCache(function)  # type: ignore[no-untyped-call] # noqa: SLF001
        return dispatcher  # type: ignore[no-any-return]

    return compiled


def kernel_part(**options: Any) -> Callable[[_Function], _Function]:
    """Called from Python, a part runs as Python.

    What a parallel loop itself calls is better a kernel: parts are compiled for the loop and again around it.
    """
    decorator: Callable[[_Function], _Function] = register_jitable(no_cfunc_wrapper=True, **options)
    return decorator
