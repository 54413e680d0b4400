"""Select where tasks run: processes of this machine, or a cluster of Dask or Ray."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import joblib

from ..errors import UnusableInput

BACKENDS = ("multiprocessing", "loky", "dask", "ray")
"""Names of the joblib back ends that can be chosen."""


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
        with joblib.parallel_config(chosen):
            yield


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
        return Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise UnusableInput(
            f"--cluster {address}: no Dask scheduler answers there ({error}); "
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
