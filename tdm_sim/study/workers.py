# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Independent runs on all cores, or on the machines of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib import import_module
from itertools import islice
import logging
from multiprocessing import resource_tracker
import os
import signal
from tempfile import TemporaryDirectory
from typing import TypeVar

import dask
from distributed import as_completed, Client, Future, KilledWorker, LocalCluster
from tdm_planner.exceptions import InvalidProblem, one_line

Argument = TypeVar('Argument')
Result = TypeVar('Result')

_AHEAD = 2  # tasks that a worker has: one at work, one waiting
_CONNECTED = 10  # s in which a scheduler must answer


@contextmanager
def workers(
    scheduler: str | None = None, count: int | None = None, module: str = __name__
) -> Iterator[Client]:
    """
    Start a pool of workers: one process a core, `count` of them, or those of a Dask cluster.

    `scheduler` is the cluster's, ``HOST:PORT``; its workers must have the `module` of the work.
    Local processes are ended at the end, and listen on this machine only.

    Raise InvalidProblem if no scheduler answers there, or a worker lacks the module.
    """
    for name in ('distributed', 'distributed.client'):  # what is lost is done again, or told
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            address = scheduler if '://' in scheduler else f'tcp://{scheduler}'
            client = Client(address, timeout=_CONNECTED)
        except (OSError, ValueError):
            raise InvalidProblem(
                f"scheduler '{scheduler}' does not answer: must be HOST:PORT of a Dask scheduler"
            ) from None
        with client:
            try:
                client.run(import_module, module)  # its absence would end the process with a task
            except Exception as error:  # noqa: B902 - whatever the import raises there
                raise InvalidProblem(
                    f"workers of '{scheduler}' cannot import '{module}': {one_line(error)}; they "
                    "must have it installed, or its folder in 'PYTHONPATH'"
                ) from None
            yield client
        return
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        # Threads and processes ignore what a terminal sends to all of them; in this thread it is
        # pending meanwhile. A resource tracker that starts later unblocks it.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            local = LocalCluster(
                n_workers=count or len(os.sched_getaffinity(0)),
                threads_per_worker=1,
                memory_limit=None,
                dashboard_address='127.0.0.1:0',
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        with local, Client(local) as client:
            yield client


def each(
    client: Client,
    work: Callable[[Argument], Result],
    arguments: Sequence[Argument],
    lost: Callable[[Argument], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """
    Yield the index of every argument and the result of `work`, in the order of completion.

    The task of a worker that died goes to another. For an argument that ends every worker, `lost`
    gives the result; without it `KilledWorker` is raised. Raise InvalidProblem if the scheduler
    is gone.
    """
    numbers: dict[Future, int] = {}
    running, waiting = as_completed(loop=client.loop), enumerate(arguments)
    most = 0

    def start() -> None:
        nonlocal most
        if not most or client.cluster is None:  # a cluster elsewhere may get more workers
            most = max(most, _AHEAD * (sum(client.nthreads().values()) or 1))
        for number, argument in islice(waiting, most - len(numbers)):
            future = client.submit(work, argument, pure=False)
            numbers[future] = number
            running.add(future)

    start()
    for future in running:
        number = numbers.pop(future)
        try:
            result = future.result()
        except KilledWorker:
            if lost is None:
                raise
            result = lost(arguments[number])
        except CancelledError:
            raise InvalidProblem(
                'the Dask scheduler is gone: start one, and the same command goes on from here'
            ) from None
        future.release()
        start()
        yield number, result


dask.config.set({'distributed.comm.timeouts.connect': f'{_CONNECTED}s'})
