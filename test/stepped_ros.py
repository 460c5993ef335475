# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Nodes in the test's own process, under a clock that the test steps: as fast as it computes.

Nodes are constructed as their `main` would, in one context and one executor; messages go through
DDS. All run with `use_sim_time`, and what they take from steady clocks follows the same clock.
`Stepped.spin_until` serves callbacks until there is none, waits for solves under way while time
stands still, then steps to the next timer: a busy machine changes nothing. Clocks may be wrong:
`Stepped.leap` sets the simulated one, `time_of_day` that of nodes with `use_sim_time` false.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import gc
import importlib
from pathlib import Path
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from rclpy.clock import Clock as RclpyClock
from rclpy.clock import ClockType, ROSClock
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.impl import rcutils_logger
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from rclpy.time import Time
from ros_harness import MODULES, QUEUE, Ros, Started
from rosgraph_msgs.msg import Clock

BEGIN = 1_800_000_000_000_000_000  # ns
LONGEST_STEP = 5_000_000  # ns
SHORTEST_STEP = 10_000  # ns; a timer that is due but was not served yet cannot stop the clock
STUCK = 240.0  # s of real time without progress, after which a test fails; kernels compile once
CLASSES = {'planner': 'Planner', 'tracker': 'TrackerNode', 'pendulum_plant': 'PendulumPlant',
           'robot_plant': 'RobotPlant', 'plant': 'StatedPlant'}  # fmt: skip


class SteppedTime:
    """The machine's clocks as the nodes see them; stands in for the module `time` there."""

    def __init__(self) -> None:
        self.now, self._moved = BEGIN, threading.Condition()
        self.steady: list[ROSClock] = []
        self.wakes: dict[int, int] = {}  # instants [ns] by thread that sleeps

    def step_to(self, now: int) -> None:
        """Set every steady clock; who has slept long enough is woken by `wake`."""
        self.now = now
        for clock in self.steady:
            clock.set_ros_time_override(Time(nanoseconds=now, clock_type=ClockType.ROS_TIME))

    def wake(self) -> bool:
        """Wake who has slept long enough; False if there is nobody."""
        with self._moved:
            due = [thread for thread, at in self.wakes.items() if at <= self.now]
            for thread in due:
                del self.wakes[thread]
            self._moved.notify_all()
        return bool(due)

    def steady_clock(self, *, clock_type: ClockType = ClockType.STEADY_TIME) -> RclpyClock:
        """Return a clock that shows this time, whatever its type would be."""
        clock = ROSClock()
        clock._set_ros_time_is_active(True)
        clock.set_ros_time_override(Time(nanoseconds=self.now, clock_type=ClockType.ROS_TIME))
        self.steady.append(clock)
        return clock

    def as_module(self) -> SimpleNamespace:
        clocks = dict.fromkeys(('monotonic', 'perf_counter', 'time'), lambda: self.now * 1e-9)
        clocks |= dict.fromkeys(('monotonic_ns', 'time_ns'), lambda: self.now)
        return SimpleNamespace(**clocks, sleep=self._sleep)

    def _sleep(self, seconds: float) -> None:
        assert seconds >= 0.0
        if threading.current_thread() is threading.main_thread():
            assert seconds < 1.0, 'so long a node must not keep others waiting'
            return  # a pause of the node itself, so that a message may arrive: it has
        with self._moved:
            me = threading.get_ident()
            self.wakes[me] = self.now + max(round(seconds * 1e9), SHORTEST_STEP)
            self._moved.wait_for(lambda: me not in self.wakes)


class OrderedExecutor(SingleThreadedExecutor):
    """Serves nodes in the order in which they were added, not in that of their addresses."""

    def __init__(self, **options: Any) -> None:
        self.numbers: dict[Any, int] = {}
        super().__init__(**options)

    def get_nodes(self) -> list[Any]:
        return sorted(super().get_nodes(), key=self.numbers.__getitem__)

    def add_node(self, node: Any) -> bool:
        self.numbers[node] = len(self.numbers)
        return bool(super().add_node(node))


class NodeHere(Started):
    running = True

    def __init__(self, ros: Stepped, node: Any) -> None:
        self.node, self._ros = node, ros

    @property
    def output(self) -> str:
        name = self.node.get_logger().name
        return ''.join(f'{text}\n' for logger, text in self._ros.log if logger == name)

    def end(self) -> int:
        if self.running:
            self.running = False
            self._ros.settle()  # what it computes would be handed over to nobody
            self._ros._executor.remove_node(self.node)
            self.node.destroy_node()
        return 0


class Stepped(Ros):
    """A ROS domain of the test's own, whose time is the test's."""

    common: ClassVar[dict[str, Any]] = {'use_sim_time': True}
    executor, depth = OrderedExecutor, QUEUE

    def __init__(self, domain: int, folder: Path, environment: Mapping[str, str]) -> None:
        super().__init__(domain, folder, environment)
        self.time, self._patch = SteppedTime(), pytest.MonkeyPatch()
        self.log: list[tuple[str, str]] = []
        self.nodes: list[NodeHere] = []
        self._worked, self._tells = False, True
        self._strangers = set(threading.enumerate())
        self._leapt, self.time_of_day = 0, 0.0  # ns; s by which it is wrong
        self._clock = self.node.create_publisher(Clock, '/clock', 1)
        self.node.set_parameters([Parameter('use_sim_time', value=True)])
        self.statuses: dict[str, Any] = {}  # the newest, by name
        hear = lambda array: self.statuses.update((s.name, s) for s in array.status)  # noqa: E731
        self.node.create_subscription(DiagnosticArray, '/diagnostics', hear, 50)
        send = rcutils_logger._rclpy.rclpy_logging_rcutils_log

        def note(severity: Any, name: str, text: str, *place: Any) -> None:
            self.log.append((name, f'[{LoggingSeverity(severity).name}] [{name}]: {text}'))
            send(severity, name, text, *place)

        stand_in = SimpleNamespace(**vars(rcutils_logger._rclpy))
        stand_in.rclpy_logging_rcutils_log = note
        self._patch.setattr(rcutils_logger, '_rclpy', stand_in)
        throttle = rcutils_logger.Throttle.params  # by which warnings are held back for a while
        self._patch.setitem(throttle, 'throttle_time_source_type', self.time.steady_clock())
        self._patch.setattr(ROSClock, 'now', lambda clock: self._now_of(clock))
        # Warnings of rclpy's own, which cost a third of the time of waiting.
        self._patch.setattr(PublisherEventCallbacks, 'create_event_handlers', lambda *of: [])
        listen = SubscriptionEventCallbacks.create_event_handlers
        some = lambda self, *of: listen(self, *of) if self.message_lost else []  # noqa: E731
        self._patch.setattr(SubscriptionEventCallbacks, 'create_event_handlers', some)
        for module in MODULES.values():
            importlib.import_module(module)
        self._lend_clock()

    def _begin(self, role: str, arguments: list[str]) -> NodeHere:
        module = importlib.import_module(MODULES[role])
        return self.add(getattr(module, CLASSES[role]), arguments)

    def add(self, make: Callable[..., Any], arguments: list[str]) -> NodeHere:
        self._lend_clock()
        here = NodeHere(self, make(context=self._context, cli_args=arguments))
        self._executor.add_node(here.node)
        self.nodes.append(here)
        self._tell_time()
        self.settle()
        return here

    def said(self, name: str, *texts: str, level: int | None = None) -> bool:
        """Whether the newest status of that name has all the texts, and the level if given."""
        status = self.statuses.get(name)
        if status is None or level not in (None, status.level[0]):
            return False
        return all(text in status.message for text in texts)

    def says(self, name: str, *texts: str, level: int | None = None, timeout: float = 5.0) -> bool:
        return self.spin_until(lambda: self.said(name, *texts, level=level), timeout)

    def figure(self, name: str, key: str) -> str:
        return {item.key: item.value for item in self.statuses[name].values}[key]

    @property
    def now(self) -> int:  # [ns]
        return self.time.now

    def spin_until(self, condition: Callable[[], bool], timeout: float = 10.0) -> bool:
        """Serve and step until `condition` holds; False when `timeout` s of its time are over."""
        end = self.now + round(timeout * 1e9)
        patience = time.monotonic() + STUCK
        while not condition():
            computes = self._computes()  # before serving: its outcome is a task by then
            if self._serve():
                continue
            if computes:
                assert time.monotonic() < patience, 'a computation does not end'
                time.sleep(0.0005)
                continue
            if self.time.wake():  # threads see an instant when all that belongs to it was served
                continue
            if self.now >= end:
                return False
            self.step_to(min(self._next(), end))
            patience = time.monotonic() + STUCK
        return True

    def meet(self, known: Callable[[], bool]) -> bool:
        """Wait, while time stands still, for what the middleware does in threads of its own."""
        patience = time.monotonic() + STUCK
        while not known() and time.monotonic() < patience:
            if not self._serve():
                time.sleep(0.0005)
        return known()

    def do(self, what: Callable[..., Any], *arguments: Any, still: bool = False) -> Any:
        """Do something in a thread while nodes are served, in time or while it stands `still`."""
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(what, *arguments)
            assert (self.meet if still else self.spin_until)(future.done)
            return future.result()

    def silent(self, received: list[Any], seconds: float = 0.3) -> bool:
        """Whether nothing is received for a while."""
        self.settle()
        count = len(received)
        self.spin_for(seconds)
        return len(received) == count

    def settle(self) -> None:
        """Serve all there is, and wait for solves under way, while time stands still."""
        self.spin_for(0.0)

    def step_to(self, now: int) -> None:
        self.time.step_to(now)
        self._tell_time()

    def leave_clock(self) -> None:
        """Let a node that drives `/clock` tell the time from now on."""
        self.node.destroy_publisher(self._clock)
        self._tells = False

    def leap(self, seconds: float) -> None:
        """Set the simulated clock, and no other, by so much."""
        self._leapt += round(seconds * 1e9)
        self._tell_time()

    def _tell_time(self) -> None:
        if self._tells:
            self._clock.publish(Clock(clock=Time(nanoseconds=self.now + self._leapt).to_msg()))

    def _serve(self) -> bool:
        """Run one callback; False if there is none."""
        worked, self._worked = self._worked, False
        handler = None
        with suppress(TimeoutException):
            handler, _, _ = self._executor.wait_for_ready_callbacks(timeout_sec=0.0)
        if handler is None:  # what was found before is done; it may have made more
            return worked and self._serve()
        handler()
        error = handler.exception()
        over = isinstance(error, InvalidHandle) and not all(here.running for here in self.nodes)
        if error is not None and not over:  # of a node that has ended meanwhile nothing is left
            raise error
        self._worked = True
        return True

    def _computes(self) -> bool:
        """Whether a solve is under way that does not wait for time to pass."""
        threads = set(threading.enumerate()) - self._strangers
        workers = {thread.ident for thread in threads if thread.name == 'tdm_planner worker'}
        return not workers <= self.time.wakes.keys()

    def _next(self) -> int:
        """Instant of the next timer or wake-up [ns]."""
        timers = [timer for here in self.nodes if here.running for timer in here.node.timers]
        waits = [t.time_until_next_call() for t in timers if not t.is_canceled()]
        waits += [wake - self.now for wake in list(self.time.wakes.values())]
        return self.now + max(min([LONGEST_STEP, *waits]), SHORTEST_STEP)

    def _lend_clock(self) -> None:
        """Give the modules of the nodes this time; those imported since are met here, too."""
        stand_in = self.time.as_module()
        for name, module in list(sys.modules.items()):
            if name.startswith(('tdm_planner.nodes.', 'tdm_sim.')):
                if getattr(module, 'time', None) is time:
                    self._patch.setattr(module, 'time', stand_in)
                if getattr(module, 'Clock', None) is RclpyClock:
                    self._patch.setattr(module, 'Clock', self.time.steady_clock)

    def _now_of(self, clock: ROSClock) -> Time:
        if clock.ros_time_is_active:
            return RclpyClock.now(clock)
        shown = self.now + round(self.time_of_day * 1e9)
        return Time(nanoseconds=shown, clock_type=clock.clock_type)

    def close(self) -> None:
        """End everything; a log that looks like a crash fails the module."""
        try:
            for here in self.nodes:
                here.end()
            super().close()
        finally:
            self._patch.undo()
            self.nodes.clear()
            # A participant ends with the last that refers to it. Of those that are left, a process
            # may have 32 before the next is not discovered; and nodes freeze what they refer to.
            gc.unfreeze()
            gc.collect()
        assert not any('Traceback' in text for _, text in self.log)
