"""How compiled functions are loaded."""

import subprocess
import sys

PROGRAM = """
import sys
import numpy as np
from fpplab.clouds.selection import are_finite
assert are_finite(np.ones((2, 3), np.float32))
print(sum(are_finite.stats.cache_hits.values()), "numba.cpython.heapq" in sys.modules)
"""


def test_a_kernel_from_the_cache_is_loaded_without_the_compiler() -> None:
    for _ in range(2):  # the first may compile it
        program = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
        if program.stdout.startswith("1"):
            break
    assert program.stdout.split() == ["1", "False"]
