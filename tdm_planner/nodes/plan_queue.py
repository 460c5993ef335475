# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The planner's queue: one computation at a time beside the executor, requests before reviews.

A *request* is solved as soon as the computation under way has ended; while one waits or is being
solved, the next is answered BUSY. A *task* (preparing the problem, checking a recovered plan)
waits for requests. A *review* of the active plan begins only where there is nothing else to do,
and a request supersedes it: its outcome is dropped.

A computation cannot be interrupted. One whose outcome is of no use any more (another plan became
active, the node was deactivated) is *stale*, and its outcome dropped when it comes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import threading
from typing import Any, Literal

from rclpy.node import Node
from tdm_planner.exceptions import Busy, TdmError

Compute = Callable[[], Any]
Done = Callable[[Any], None]
Kind = Literal['request', 'task', 'review']


@dataclass(eq=False)
class _Job:
    kind: Kind
    compute: Compute
    done: Done
    stale: bool = False


class PlanQueue:
    """
    Runs `compute()` in a daemon thread and calls `done(outcome)` in the node's executor.

    The outcome is what `compute` returns, or the exception it raised. Methods are called in
    callbacks of the executor. A daemon, because a computation under way must not keep the process
    from ending; compiled kernels release the interpreter's lock, so the executor goes on.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._running: _Job | None = None
        self._waiting: deque[_Job] = deque()

    @property
    def solving(self) -> bool:
        """Whether a request waits or is being solved."""
        return any(job.kind == 'request' for job in self._jobs)

    def request(self, compute: Compute, done: Done) -> None:
        """
        Solve a request next.

        Raise Busy while another request waits or is being solved.
        """
        if self.solving:
            raise Busy('a request is being solved: ask again when it is answered')
        self.drop_review()
        self._waiting.appendleft(_Job('request', compute, done))
        self._next()

    def task(self, compute: Compute, done: Done) -> None:
        """Compute something when there is no request."""
        self._waiting.append(_Job('task', compute, done))
        self._next()

    def review(self, compute: Compute, done: Done) -> None:
        """Review the active plan, if there is nothing else to do."""
        if not self._jobs:
            self._waiting.append(_Job('review', compute, done))
            self._next()

    def drop_review(self) -> None:
        """Drop the outcome of a review under way: it is of a plan that is not active any more."""
        if self._running is not None and self._running.kind == 'review':
            self._running.stale = True

    def cancel(self, error: TdmError) -> None:
        """Drop everything; a request that is not answered yet is done with `error`."""
        dropped = [job for job in self._jobs if not job.stale]
        self._waiting.clear()
        for job in dropped:
            job.stale = True
            if job.kind == 'request':
                job.done(error)

    @property
    def _jobs(self) -> list[_Job]:
        return [*filter(None, [self._running]), *self._waiting]

    def _next(self) -> None:
        if self._running is not None or not self._waiting:
            return
        job = self._running = self._waiting.popleft()
        threading.Thread(
            target=self._run, args=(job,), name='tdm_planner worker', daemon=True
        ).start()

    def _run(self, job: _Job) -> None:
        try:
            outcome = job.compute()
        except Exception as error:  # noqa: B902
            outcome = error
        executor = self._node.executor
        if executor is not None:  # None: the node is being destroyed
            executor.create_task(self._deliver, job, outcome)

    def _deliver(self, job: _Job, outcome: Any) -> None:
        self._running = None
        if not job.stale:
            job.done(outcome)
        self._next()
