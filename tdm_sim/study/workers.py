# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Independent runs on all cores, or on the machines of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
import logging
import math
from multiprocessing import resource_tracker
import os
import signal
from tempfile import TemporaryDirectory
import time
from typing import Any, TypeVar

import dask
from distributed import as_completed, Client, Future, KilledWorker, LocalCluster
from tdm_planner.exceptions import InvalidProblem

Argument = TypeVar('Argument')
Result = TypeVar('Result')

_AHEAD = 2  # batches that a worker has: one at work, one waiting
_BATCH_TIME = 0.5  # s of work that are sent at once, about
_CONNECTED = 10  # s in which a scheduler must answer


@contextmanager
def workers(scheduler: str | None = None, count: int | None = None) -> Iterator[Client]:
    """
    Start a pool of workers: one process a core, `count` of them, or those of a Dask cluster.

    `scheduler` is the cluster's, ``HOST:PORT``. Local processes are ended at the end, and listen
    on this machine only.

    Raise InvalidProblem if no scheduler answers there.
    """
    logging.getLogger('distributed').setLevel(logging.CRITICAL)  # what is lost is done again
    if scheduler is not None:
        try:
            address = scheduler if '://' in scheduler else f'tcp://{scheduler}'
            client = Client(address, timeout=_CONNECTED)
        except (OSError, ValueError):
            raise InvalidProblem(
                f"scheduler '{scheduler}' does not answer: must be HOST:PORT of a Dask scheduler"
            ) from None
        with client:
            yield client
        return
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        # Threads and processes ignore SIGINT, which a terminal sends to all of them; in this
        # thread it is pending meanwhile. A resource tracker that starts later unblocks it.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
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
    gives the result; without it `KilledWorker` is raised. Arguments are sent in batches of about
    half a second, a few at a time.
    """
    total = sum(client.nthreads().values()) or 1
    waiting, left = iter(range(len(arguments))), len(arguments)
    alone: list[int] = []  # of batches that were lost
    batches: dict[Future, list[int]] = {}
    running = as_completed(loop=client.loop)
    size = 1

    def start() -> None:
        batch = [alone.pop()] if alone else list(islice(waiting, size))
        if batch:
            given = [arguments[index] for index in batch]
            future = client.submit(_worked, work, given, pure=False)
            batches[future] = batch
            running.add(future)

    for _ in range(_AHEAD * total):
        start()
    for future in running:
        batch = batches.pop(future)
        try:
            results, seconds = future.result()
        except KilledWorker:
            if len(batch) > 1:
                alone += batch
                start()
                continue
            if lost is None:
                raise
            results, seconds = [lost(arguments[batch[0]])], _BATCH_TIME
        left -= len(batch)
        enough = round(_BATCH_TIME * len(batch) / max(seconds, 1e-6))
        size = max(1, min(enough, 2 * size, math.ceil(left / (_AHEAD * total))))
        future.release()
        start()
        yield from zip(batch, results, strict=True)


def _worked(work: Callable[[Any], Any], given: Sequence[Any]) -> tuple[list[Any], float]:
    """Return what comes of a batch, and how long it took [s]."""
    began = time.perf_counter()
    return [work(argument) for argument in given], time.perf_counter() - began


dask.config.set({'distributed.comm.timeouts.connect': f'{_CONNECTED}s'})
