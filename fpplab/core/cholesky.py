"""Small symmetric systems solved within compiled loops, where raising an exception is not possible."""

import numpy as np

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats


@kernel(error_model="numpy")
def solve_positive(matrix: Floats, right: Floats, damping: float, solution: Floats) -> bool:
    # matrix (n, n); right (n,); solution (n,)
    n = len(right)
    lower = np.zeros((n, n))
    for k in range(n):
        for q in range(k + 1):
            rest = matrix[k, q] * (1.0 + damping if q == k else 1.0)
            for r in range(q):
                rest -= lower[k, r] * lower[q, r]
            if q < k:
                lower[k, q] = rest / lower[q, q]
            elif rest > 1e-14 * matrix[k, k]:
                lower[k, k] = np.sqrt(rest)
            else:
                return False
    for k in range(n):
        rest = right[k]
        for q in range(k):
            rest -= lower[k, q] * solution[q]
        solution[k] = rest / lower[k, k]
    for k in range(n - 1, -1, -1):
        rest = solution[k]
        for q in range(k + 1, n):
            rest -= lower[q, k] * solution[q]
        solution[k] = rest / lower[k, k]
    return True
