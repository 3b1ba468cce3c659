"""Dask's clusters as executors, where one machine is not enough."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from mbocp._environment import available_workers
from mbocp._processes import signal_handler
from mbocp.exceptions import StudyError

_TIMEOUT = 10.0  # [s] for a scheduler to answer


@contextmanager
def dask_executor(address: str, workers: int | None = None) -> Iterator[tuple[Executor, int]]:
    """Give Dask's executor and its number of workers; "local" starts a cluster on this machine.

    Raises
    ------
    StudyError
        If `distributed` is not installed, or nobody answers at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise StudyError("--scheduler needs Dask: pip install 'mbocp[dask]'") from error
    # A task that kills its worker is not given to three others.
    settings = {"distributed.scheduler.allowed-failures": 0}
    with dask.config.set(settings):
        if address == "local":
            count = workers or available_workers()
            # Ctrl-C reaches all processes of a terminal; those that are started now leave it to this one.
            with signal_handler(signal.SIGINT, signal.SIG_IGN):
                cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
            with cluster, Client(cluster) as client:
                yield client.get_executor(), count
            return
        try:
            client = Client(address, timeout=_TIMEOUT)
        except (OSError, ValueError) as error:
            raise StudyError(f"--scheduler {address}: nobody answers there ({error})") from error
        with client:
            threads = sum(client.nthreads().values())
            if not threads:
                raise StudyError(f"--scheduler {address}: the scheduler has no workers yet; start some")
            yield client.get_executor(), workers or threads
