# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The operations that the page offers by buttons, sliders and dragging.

They run one at a time; a newer one supersedes a waiting one of its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
import threading
import time
from typing import Any

from tdm_planner.exceptions import Busy, TdmError
from tdm_sim.live.listener import Listener, PLANNING, SIMULATION
from tdm_sim.live.recordings import RecordingFailed, Recordings
from tdm_sim.live.rig import Rig
from tdm_sim.live.scene import DragHandle, Pose, pulled
from tdm_sim.live.sliders import Slider

Act = Callable[[], str]
Told = Callable[[str], None]
SHORTEST, LONGEST = 0.2, 1.0  # s from a request to the start of the motion
REPLAN_RATE = 5.0  # Hz
PATIENCE = 120.0  # s for a plan: the planner may have to compile its kernels
_LOOK = 0.02  # s between requests while the planner is busy
_ARRIVAL = 0.03  # s for the states after a reset to arrive at the planner


class TaskThread:
    """
    Runs tasks in its own thread, one at a time.

    A waiting task is superseded by a newer one of its kind. A drag so yields as many plans as
    solving allows, and the last one is for the place where the drag ended.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, tuple[Act, Told]] = {}
        self._news = threading.Condition()
        self._ended = False
        self._busy = False
        self._thread = threading.Thread(target=self._run, name='live tasks', daemon=True)
        self._thread.start()

    def submit(self, kind: str, act: Act, told: Told) -> None:
        """
        Run `act()`, then call `told(text)` with its result or the reason for its failure.

        `told` is not called for a task that is superseded before its turn.
        """
        with self._news:
            self._waiting[kind] = act, told
            self._news.notify()

    @property
    def idle(self) -> bool:
        """Whether every task has ended."""
        with self._news:
            return not self._waiting and not self._busy

    def close(self) -> None:
        """Drop the waiting tasks; the running one ends by itself."""
        with self._news:
            self._ended = True
            self._waiting.clear()
            self._news.notify()

    def _run(self) -> None:
        while True:
            with self._news:
                self._busy = False
                self._news.wait_for(lambda: self._ended or bool(self._waiting))
                if self._ended:
                    return
                kind = next(iter(self._waiting))
                act, told = self._waiting.pop(kind)
                self._busy = True
            told(_outcome(act))


def _outcome(act: Act) -> str:
    try:
        return act()
    except TdmError as error:
        return f'{error.code}: {error}'
    except Exception as error:  # noqa: B902
        # The page goes on, and shows it.
        return f'INTERNAL: {type(error).__name__}: {error}'


def start_delay(solve_time: float) -> float:
    """
    Return `start.delay` [s] of the next request; the last one took `solve_time` s to solve.

    As short as solving allows: until a plan's motion has begun, the next one is not made.
    """
    return min(max(2.0 * solve_time + 0.1, SHORTEST), LONGEST)


class Operations:
    """
    Runs the page's operations in a task thread, and reports their outcome.

    `note` receives the outcome of buttons. Recordings and reports have a thread of their own.
    """

    def __init__(self, rig: Rig, listener: Listener, recordings: Recordings, note: Told) -> None:
        self.rig, self._listener, self._recordings, self._note = rig, listener, recordings, note
        self._plant_tasks, self._file_tasks = TaskThread(), TaskThread()
        self._delay: float | None = None

    def close(self) -> None:
        """Drop the waiting tasks, and end a recording."""
        self._plant_tasks.close()
        self._file_tasks.close()
        with suppress(RecordingFailed):
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
        rate = REPLAN_RATE if on else 0.0

        def act() -> str:
            self._set_planner({'replan.rate': rate})
            return f'replanning at {rate:g} Hz' if on else 'no replanning'

        self._plant_tasks.submit('replan', act, self._note)

    def change(self, slider: Slider, value: float, told: Told) -> None:
        """Set a parameter on all nodes that have it, and replan if the planner is among them."""

        def act() -> str:
            nodes = self._listener.with_parameter(slider.name)
            self._listener.set_parameters(nodes, {slider.name: type(slider.value)(value)})
            planner = self._listener.parameters_of(PLANNING)
            if self.rig.plan is not None and planner and slider.name in planner.values:
                self._make_plan()
            return ''

        self._plant_tasks.submit(slider.name, act, told)

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
            if handle.node == 'planner':
                changes = handle.values_at(pose, self._values(PLANNING))
                self._make_plan(changes)
                self._set_planner(changes)
            else:
                changes = handle.values_at(pose, self._values(SIMULATION))
                plants = [node.name for node in self._listener.having(SIMULATION)]
                self._listener.set_parameters(plants, changes)
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
                self._delay = start_delay(plan.solve_time)
                return plan.summary
            except Busy:
                if time.monotonic() > end:
                    raise
                time.sleep(_LOOK)

    def _await_start(self) -> None:
        """Wait until the newest plan has begun: until then the planner makes no other."""
        end = time.monotonic() + 2.0 * LONGEST
        while (plan := self._listener.client.newest) is not None and time.monotonic() < end:
            if all(motion.instant >= plan.start for motion in self.rig.motions.values()):
                return
            time.sleep(_LOOK)

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

    def _set_planner(self, values: Mapping[str, Any]) -> None:
        self._listener.set_parameters(
            [node.name for node in self._listener.having(PLANNING)], values
        )

    def _values(self, role: str) -> Mapping[str, Any]:
        declared = self._listener.parameters_of(role)
        return {} if declared is None else declared.values
