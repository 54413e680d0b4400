"""Select where tasks run: processes of this machine, or a cluster of Dask or Ray."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

import joblib
from joblib.parallel import FallbackToBackend, MultiprocessingBackend, SequentialBackend

from .._system.bounded_wait import value_within
from ..errors import UnusableInput, WorkerKilled

BACKENDS = ("multiprocessing", "loky", "dask", "ray")
"""Names of the joblib back ends that can be chosen."""
CONNECTION_SECONDS = 10.0
"""Time within which the scheduler of a Dask cluster must accept a connection, and again the time
within which it must answer [s]."""


class ForkedProcesses(MultiprocessingBackend):  # type: ignore[misc]
    """joblib's back end "multiprocessing", except that a process that is killed ends the run.

    The pool of `multiprocessing` waits for ever for the result of a process that the system has
    killed, as it does where memory is short; that of `concurrent.futures` raises an error.
    """

    _pool: ProcessPoolExecutor | None = None
    _count = 0

    def configure(self, n_jobs: int = 1, parallel: Any = None, **_: Any) -> int:
        """Start the processes and return their number."""
        count = int(self.effective_n_jobs(n_jobs))
        if count == 1:
            raise FallbackToBackend(SequentialBackend(nesting_level=self.nesting_level))
        can_fork = "fork" in multiprocessing.get_all_start_methods()
        context = multiprocessing.get_context("fork" if can_fork else None)
        with _started_completely(count):
            self._pool = ProcessPoolExecutor(count, context)
        self._count, self.parallel = count, parallel
        return count

    def submit(
        self, func: Callable[[], Any], callback: Callable[[Future[Any]], None] | None = None
    ) -> Future[Any]:
        """Send a task to the processes."""
        assert self._pool is not None
        try:
            with _started_completely(self._count):
                future = self._pool.submit(func)
        except UnusableInput:
            self._pool = None  # an incomplete one cannot be shut down
            raise
        if callback is not None:
            future.add_done_callback(callback)
        return future

    def retrieve_result_callback(self, result: Future[Any]) -> Any:
        """Return the result of a task, or raise its error."""
        return result.result()

    def terminate(self) -> None:
        """End the processes after the tasks that have begun."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None
        self.reset_batch_stats()


@contextmanager
def _started_completely(count: int) -> Iterator[None]:
    """Kill the child processes that the block has started if it cannot start all.

    The first task starts all processes of a pool. Those that wait for tasks of a pool that is
    incomplete would never end, and Python waits for them when it ends.

    Args:
        count: Number of processes, for the message.

    Raises:
        UnusableInput: The system has no more processes, threads, files or semaphores.
    """
    before = set(multiprocessing.active_children())
    try:
        yield
    except BrokenProcessPool:
        raise
    except (OSError, RuntimeError) as error:
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise UnusableInput(
            f"{count} processes for the starts cannot be started "
            f"({getattr(error, 'strerror', None) or error}); use --jobs 1"
        ) from error


def default_backend() -> str:
    """Return the fastest back end of this machine.

    Forked processes start in milliseconds but are safe on Linux only; loky takes a second.
    """
    return "multiprocessing" if sys.platform == "linux" else "loky"


@contextmanager
def backend(name: str | None, address: str | None = None) -> Iterator[None]:
    """Send the tasks of joblib to a back end for the duration of the context.

    Args:
        name: One of `BACKENDS`; None: the default.
        address: Address of a running cluster (Dask: tcp://host:8786, Ray: ray://host:10001); None:
            a cluster of this machine.

    Raises:
        UnusableInput: The package of the back end is missing, or the cluster does not answer.
        WorkerKilled: A process of this machine was killed.
    """
    chosen = name or ("dask" if address else default_backend())
    if address and chosen not in ("dask", "ray"):
        raise UnusableInput(
            f"--cluster {address}: --backend {chosen} has no cluster; "
            "use --backend dask or --backend ray"
        )
    if chosen == "dask":
        with _dask(address), joblib.parallel_config("dask"):
            yield
    elif chosen == "ray":
        _ray(address)
        with joblib.parallel_config("ray"):
            yield
    else:
        processes = ForkedProcesses() if chosen == "multiprocessing" else chosen
        try:
            with joblib.parallel_config(processes):
                yield
        except BrokenProcessPool as error:
            raise WorkerKilled(
                "a process that ran some of the starts was killed, perhaps as memory is short; run "
                "fewer of them with --jobs 1"
            ) from error


def _dask(address: str | None) -> Any:
    """Return a client of a Dask cluster."""
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise UnusableInput(
            "--backend dask: Dask is not installed; .venv/bin/pip install -e '.[dask]'"
        ) from error
    try:
        if address is None:
            return Client(threads_per_worker=1, dashboard_address=None)
        # it bounds the time of the connection, not that of the greeting; a thread that still waits
        # when the process ends gets a NameError
        return value_within(
            2.0 * CONNECTION_SECONDS,
            lambda: Client(address, timeout=CONNECTION_SECONDS),
            (OSError, ValueError, NameError),
        )
    except (OSError, ValueError) as error:
        reason = str(error) or "it accepts the connection, but does not answer"
        raise UnusableInput(
            f"--cluster {address}: no Dask scheduler answers there ({reason}); "
            "start one with: dask scheduler"
        ) from error


def _ray(address: str | None) -> None:
    """Connect joblib to a Ray cluster."""
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError as error:
        raise UnusableInput(
            "--backend ray: Ray is not installed; .venv/bin/pip install -e '.[ray]'"
        ) from error
    try:
        ray.init(address=address, ignore_reinit_error=True)
    except (ConnectionError, ValueError) as error:
        raise UnusableInput(
            f"--cluster {address}: no Ray cluster answers there ({error})"
        ) from error
    register_ray()
