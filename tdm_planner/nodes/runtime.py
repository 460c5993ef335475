# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process: start, spin, end cleanly on a signal. Every `main` is `run`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import os
import signal
import sys
import threading
from types import FrameType

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
LONGEST_WAIT = 0.1  # s between looks at whether a signal has arrived


def make_executor(context: rclpy.Context | None = None) -> Executor:
    """Return the executor of the nodes: event-driven where this rclpy has it.

    EventsExecutor serves timers and round trips at 500 Hz with less load than the
    SingleThreadedExecutor needs for 200 Hz; both run one callback at a time.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(node: Node, executor: Executor) -> None:
    """Serve the node's callbacks until the process is asked to end."""
    executor.add_node(node)
    # EventsExecutor.spin() does not return on a signal, spin_once() does.
    while rclpy.ok():
        executor.spin_once(timeout_sec=LONGEST_WAIT)


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make the node, serve it until SIGINT or SIGTERM, and return the exit code of the process.

    `args` are the command line's (default: `sys.argv`). An error ends the process with code 1 and
    one line that says what happened.
    """
    code = 0
    node: Node | None = None
    executor: Executor | None = None
    started = interrupted = asked_to_end = False

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal asked_to_end
        asked_to_end = True
        signal.default_int_handler(number, frame)

    try:
        # Until rclpy handles signals, and before it afterwards, this is called.
        for number in _SIGNALS:
            signal.signal(number, on_signal)
        rclpy.init(args=None if args is None else list(args))
        started = True
        node = make_node()
        executor = make_executor()
        spin(node, executor)
    except ExternalShutdownException:
        pass
    except KeyboardInterrupt:
        interrupted = True
    except Exception as error:  # noqa: B902
        # A signal that shuts the context down while the node is made, or takes a message, makes
        # rclpy raise errors of its own, some of them before the context is down: the process is
        # ending as it was asked to.
        interrupted = True
        if not asked_to_end and (rclpy.ok() or not started):
            code = 1
            sentence = ' '.join(str(error).split())
            print(f'fatal: {type(error).__name__}: {sentence}', file=sys.stderr)
    finally:
        # Under `ros2 launch` Ctrl-C arrives twice; the second must not interrupt the clean-up.
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    # An EventsExecutor that was left while it took up a subscription or a publisher aborts the
    # process when it is freed; and the interpreter would tear down under a running solve.
    if (interrupted and executor is not None) or _computes():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def _computes() -> bool:
    """Whether a daemon thread (a solve) is still running."""
    return any(thread.daemon for thread in threading.enumerate() if thread.is_alive())
