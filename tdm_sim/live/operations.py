# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The operations that the page offers by buttons, sliders and dragging.

They run one at a time; a newer one supersedes a waiting one of its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from queue import SimpleQueue
import subprocess
import sys
import threading
import time
from typing import Any

from tdm_planner.exceptions import Busy, Failure
from tdm_sim.live.listener import Listener, PLANNING, SIMULATION
from tdm_sim.live.rig import Rig
from tdm_sim.live.scene import DragHandle, Pose, pulled
from tdm_sim.processes import NodeProcesses, ProcessFailed
from tdm_sim.recorder import RECORDING

Act = Callable[[], str]
Told = Callable[[str], None]
SHORTEST, LONGEST = 0.2, 1.0  # s from a request to the start of the motion
REPLAN_RATE = 5.0  # Hz
PATIENCE = 120.0  # s for a plan: the planner may have to compile its kernels
_RETRY_PERIOD = 0.02  # s between requests while the planner is busy
_FIRST = 15.0  # s that the first message of a recording may take
_ARRIVAL = 0.03  # s for the states after a reset to arrive at the planner


class Recordings:
    """Bags of a namespace in a folder, each recorded by a `tdm record` of its own."""

    def __init__(self, folder: Path, namespace: str) -> None:
        self._folder, self._namespace = folder, namespace
        self._recorder = NodeProcesses(folder / 'log')
        self.last: Path | None = None

    @property
    def running(self) -> bool:
        """Whether a recording is being made."""
        return bool(self._recorder.identifiers)

    def start(self) -> Path:
        """Begin a recording, until its first message; raise ProcessFailed if none comes."""
        bags = (self._folder / f'recording_{number}' for number in count(1))
        bag = next(bag for bag in bags if not bag.exists())
        words = ['record', '-o', str(bag), '--namespace', self._namespace]
        self._recorder.start('recorder', 'tdm_planner.cli', words)
        latest = time.monotonic() + _FIRST
        while RECORDING not in self._recorder.printed('recorder'):
            late = time.monotonic() > latest
            if late or self._recorder.ended():
                self._recorder.end()
                silent = f'no message has come in {self._namespace} within {_FIRST:g} s'
                raise ProcessFailed(silent if late else self._recorder.last_line('recorder'))
            time.sleep(_RETRY_PERIOD)
        self.last = bag
        return bag

    def stop(self) -> None:
        """End the recording; raise ProcessFailed if it is not complete."""
        if any(self._recorder.end().values()):
            raise ProcessFailed(self._recorder.last_line('recorder'))

    def report(self, problem: str) -> Path:
        """Make a report on the last recording, which ends; `problem` is the planner's."""
        assert self.last is not None  # or it is not offered
        if self.running:
            self.stop()
        file = self.last.with_suffix('.html')
        words = ['report', str(self.last), '-o', str(file), '--namespace', self._namespace, '-q']
        if ':' in problem:
            words += ['--problem', problem]
        done = subprocess.run(
            [sys.executable, '-m', 'tdm_planner.cli', *words], capture_output=True, text=True
        )
        if done.returncode:
            raise ProcessFailed(done.stderr.strip() or f'tdm report ended with {done.returncode}')
        return file


class TaskThread:
    """Runs tasks in a thread one at a time; a waiting one is superseded by a newer of its kind."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[Act, Told]] = {}
        self._kinds: SimpleQueue[str | None] = SimpleQueue()
        threading.Thread(target=self._run, name='live tasks', daemon=True).start()

    def submit(self, kind: str, act: Act, told: Told) -> None:
        """Run `act()`, then `told(text)` of its result or failure, unless superseded."""
        self._newest[kind] = act, told
        self._kinds.put(kind)

    def close(self) -> None:
        """Drop the waiting tasks; the running one ends by itself."""
        self._newest.clear()
        self._kinds.put(None)

    def _run(self) -> None:
        for kind in iter(self._kinds.get, None):
            task = self._newest.pop(kind, None)
            if task is None:
                continue
            act, told = task
            try:
                text = act()
            except Exception as error:  # noqa: B902
                # The page goes on, and shows it.
                failure = Failure.of(error)
                text = f'{failure.code}: {failure.reason}'
            told(text)


class Operations:
    """Runs operations in task threads; `note` is told the outcome of buttons."""

    def __init__(self, rig: Rig, listener: Listener, recordings: Recordings, note: Told) -> None:
        self.rig, self._listener, self._recordings, self._note = rig, listener, recordings, note
        self._plant_tasks, self._file_tasks = TaskThread(), TaskThread()
        self._delay: float | None = None

    def close(self) -> None:
        """Drop the waiting tasks, and end a recording."""
        self._plant_tasks.close()
        self._file_tasks.close()
        with suppress(ProcessFailed):
            self._recordings.stop()

    def plan(self) -> None:
        """Make a plan."""
        self._plant_tasks.submit('plan', self._make_plan, self._note)

    def push(self) -> None:
        """Push the vehicle whose curves are shown."""
        self._plant_tasks.submit('push', lambda: self._push({}, self.rig.chosen), self._note)

    def reset(self) -> None:
        """Put all plants back into their initial states."""
        self._plant_tasks.submit('reset', self._reset, self._note)

    def replan(self, on: bool) -> None:
        """Switch replanning on or off."""

        def act() -> str:
            self._set(PLANNING, {'replan.rate': REPLAN_RATE if on else 0.0})
            return f'replanning at {REPLAN_RATE:g} Hz' if on else 'no replanning'

        self._plant_tasks.submit('replan', act, self._note)

    def change(self, name: str, value: float, told: Told) -> None:
        """Set a parameter on all nodes that have it, and replan if the planner is among them."""

        def act() -> str:
            self._listener.set_parameters(self._listener.with_parameter(name), {name: value})
            if self.rig.plan is not None and name in self._values(PLANNING):
                self._make_plan()
            return ''

        self._plant_tasks.submit(name, act, told)

    def record(self) -> None:
        """Begin a recording, or end it."""

        def act() -> str:
            if not self._recordings.running:
                return f'recording to {self._recordings.start()}'
            self._recordings.stop()
            return f'recorded to {self._recordings.last}'

        self._file_tasks.submit('record', act, self._note)

    def report(self, offer: Callable[[Path], None]) -> None:
        """Make a report on the last recording, and offer it."""

        def act() -> str:
            self._note('making a report ...')
            file = self._recordings.report(self._values(PLANNING).get('problem', ''))
            offer(file)
            return f'report in {file}'

        self._file_tasks.submit('report', act, self._note)

    def drag(self, handle: DragHandle, pose: Pose, told: Told) -> None:
        """Set the parameters of a handle to where it was dragged, and plan with them."""

        def act() -> str:
            changes = handle.values_at(pose, self._values(handle.role))
            if handle.role == PLANNING:
                self._make_plan(changes)  # before they stay: there may be no plan with them
                self._set(PLANNING, changes)
            else:
                self._set(handle.role, changes)
                self._reset()
                time.sleep(_ARRIVAL)
                self._make_plan()
            return ''

        self._plant_tasks.submit(f'drag {handle.name}', act, told)

    def pull(self, name: str, start: tuple[float, ...], end: tuple[float, ...]) -> None:
        """Push a vehicle to where it was pulled."""
        problem, motion = self.rig.problem, self.rig.motions.get(name)
        if problem is not None and motion is not None:
            changes = pulled(problem, self._values(SIMULATION), motion.state, start, end)
            self._plant_tasks.submit('push', lambda: self._push(changes, name), self._note)

    # Called in the task thread.

    def _make_plan(self, own: Mapping[str, Any] | None = None) -> str:
        """Request a plan, again while the planner is busy; returns its summary."""
        asked = dict(own or {})
        if self._delay is not None:
            asked['start.delay'] = self._delay
        end = time.monotonic() + PATIENCE
        while True:
            try:
                plan = self._listener.client.plan_with(asked, timeout=PATIENCE)
                # As short as solving allows: until this motion has begun, the next waits.
                self._delay = min(max(2.0 * plan.solve_time + 0.1, SHORTEST), LONGEST)
                return plan.summary
            except Busy:
                if time.monotonic() > end:
                    raise
                time.sleep(_RETRY_PERIOD)

    def _await_start(self) -> None:
        """Wait until the newest plan has begun: until then the planner makes no other."""
        end = time.monotonic() + 2.0 * LONGEST
        while (plan := self._listener.client.newest) is not None and time.monotonic() < end:
            if all(motion.instant >= plan.start for motion in self.rig.motions.values()):
                return
            time.sleep(_RETRY_PERIOD)

    def _push(self, changes: Mapping[str, Any], name: str) -> str:
        """Push a vehicle, with parameters that are set for this push alone."""
        space = self._listener.space
        if len(self.rig.vehicles) > 1:
            space = f'{space}/{name}'
        nodes = [node.name for node in self._listener.having(SIMULATION) if node.space == space]
        values = self._values(SIMULATION)
        before = {parameter: values.get(parameter) for parameter in changes}
        self._listener.set_parameters(nodes, changes)
        try:
            return self._listener.trigger(f'{space}/push')
        finally:
            self._listener.set_parameters(nodes, before)

    def _reset(self) -> str:
        self._await_start()  # or the plan would go on from the initial state
        told = [
            self._listener.trigger(f'{node.space}/reset')
            for node in self._listener.having(SIMULATION)
            if not node.silent
        ]
        return told[0] if told else 'there is no simulated plant'

    def _set(self, role: str, values: Mapping[str, Any]) -> None:
        nodes = [node.name for node in self._listener.having(role)]
        self._listener.set_parameters(nodes, values)

    def _values(self, role: str) -> Mapping[str, Any]:
        return self._listener.parameters_of(role).values
