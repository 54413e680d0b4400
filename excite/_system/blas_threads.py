"""Number of threads of the linear algebra library (BLAS)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def single_blas_thread() -> Iterator[None]:
    """Compute with one thread of BLAS in a block; as a decorator, in a function.

    The matrices are small: their products take less time than the start of threads. One thread also
    adds numbers in the same order on every machine, so that results are repeatable whatever the
    number of processors.
    """
    from threadpoolctl import threadpool_limits  # here, so that --help does not wait for it

    with threadpool_limits(1):
        yield
