"""Functions that keep BLAS on one thread, and leave it as it was."""

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from fpplab.core.blas import one_blas_thread


def _threads() -> set[int]:
    np.linalg.inv(np.eye(2))
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_blas_works_on_one_thread_within_and_on_as_many_as_before_behind() -> None:
    with threadpool_limits(limits=2, user_api="blas"):
        before = _threads()
        assert one_blas_thread()(_threads)() == {1}
        assert _threads() == before
