import os

# In a parallel run a thread for each worker: more threads than cores wait for each other, spinning. NumPy
# reads it once, so that it is set before any test loads it.
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
