# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The life of a node's process: start, spin, end cleanly on a signal. Every `main` is `run`.

And names that it is started with, which must be such that ROS takes.
"""

from __future__ import annotations

from collections.abc import Callable
import gc
import os
import signal
import sys
import threading
import time
from types import FrameType

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_topic_name import validate_topic_name
from tdm_planner.exceptions import InvalidProblem, one_line
from tdm_planner.parameters import shown
from tdm_planner.starting import ignore_signals, SIGNALS

LONGEST_WAIT = 0.1  # s between looks at whether a signal has arrived
_GRACE = 2.0  # s after the first signal, in which others are let pass


def fault_of(name: str, validate: Callable[[str], object] = validate_topic_name) -> str:
    """Return why a name cannot be that of a topic or service, or what `validate` is for, or ''."""
    try:
        validate(name)
    except NameValidationException as error:
        return str(error).splitlines()[0].rstrip(':')
    return ''


def check_topic(name: str, of: str) -> None:
    """Raise InvalidProblem if a name cannot be that of a topic or service; `of` says whose."""
    if why := fault_of(name):
        raise InvalidProblem(f"{of} = '{shown(name)}' is not allowed: {why}")


def check_namespace(name: str, of: str) -> None:
    """Raise InvalidProblem if a name cannot be that of a namespace; `of` says whose."""
    if why := fault_of(f'/{name.strip("/")}', validate_namespace):
        raise InvalidProblem(f"{of} = '{shown(name)}' is not allowed: {why}")


def make_executor(context: rclpy.Context | None = None) -> Executor:
    """
    Return the executor of the nodes: event-driven where this rclpy has it.

    EventsExecutor serves timers and round trips at 500 Hz with less load than the
    SingleThreadedExecutor needs for 200 Hz; both run one callback at a time.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def run(make_node: Callable[[], Node]) -> int:
    """
    Make the node, spin it until one of `SIGNALS`, and return the exit code of the process.

    An error ends the process with one line: with code 2 if the node was started with invalid
    parameters (InvalidProblem) or with arguments that rclpy rejects, else with code 1.
    """
    code = 0
    node: Node | None = None
    executor: Executor | None = None
    started = broken = False
    asked: list[float] = []  # instants of signals

    def on_signal(number: int, frame: FrameType | None) -> None:
        # KeyboardInterrupt would be lost in a finaliser, interrupt the clean-up the second time,
        # and abort an executor when it is freed: only a signal long after the first raises it.
        asked.append(time.monotonic())
        if asked[-1] - asked[0] > _GRACE:
            raise KeyboardInterrupt

    try:
        for number in SIGNALS:
            signal.signal(number, on_signal)
        if others := remove_ros_args(sys.argv)[1:]:
            raise InvalidProblem(
                f"argument '{shown(others[0])}' is unknown: must follow --ros-args, as in "
                '--ros-args -p NAME:=VALUE'
            )
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        started = True
        node = make_node()
        # Exempt loaded modules from garbage collection: a full pass takes .1 s, in which no
        # command would be sent.
        gc.freeze()
        executor = make_executor()
        executor.add_node(node)
        # EventsExecutor.spin() does not return on a signal, spin_once() does.
        while rclpy.ok() and not asked:
            executor.spin_once(timeout_sec=LONGEST_WAIT)
    except ExternalShutdownException:
        pass
    except KeyboardInterrupt:
        broken = True
    except Exception as error:  # noqa: B902
        # rclpy raises when a signal or the end of the context interrupts it: the process ends.
        broken = True
        if not asked and (rclpy.ok() or not started):
            invalid = isinstance(error, InvalidProblem) or not started
            code = 2 if invalid else 1
            what = '' if invalid else f'{type(error).__name__}: '
            print(f'fatal: {what}{one_line(error)}', file=sys.stderr)
    finally:
        ignore_signals()  # under `ros2 launch` Ctrl-C arrives twice
        # Free it before the process ends, or others would see the node for another 20 s.
        if executor is not None and not broken:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    # An EventsExecutor that was left while it took up a subscription or a publisher aborts the
    # process when it is freed; and the interpreter would tear down under a running solve, which
    # is in a daemon thread.
    if (broken and executor is not None) or any(thread.daemon for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code
