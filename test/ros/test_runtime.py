# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The life of a node's process, lived in this one: how it ends, with which code, what it says."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
import gc
import math
import os
import signal
import sys
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes import runtime
from tdm_planner.nodes.planner import Planner
from tdm_planner.nodes.tracker import TrackerNode
from tdm_planner.starting import ignore_signals, Interrupted, interruptible, SIGNALS
from tdm_sim import demo
from tdm_sim.progress import Progress


class Left(BaseException):
    """The process would have been left at once, with this code."""


@pytest.fixture(autouse=True)
def _left(ros: Stepped, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave without tearing the interpreter down."""

    def leave(code: int) -> None:
        raise Left(code)

    monkeypatch.setattr(runtime, 'os', SimpleNamespace(_exit=leave))
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)
    rclpy.try_shutdown()


def run(make: Callable[[], Node], args: Sequence[str] = ()) -> int:
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, 'argv', ['node', *args])
            return runtime.run(make)
    except Left as left:
        return int(left.args[0])


def told(capfd: pytest.CaptureFixture[str]) -> list[str]:
    """Return what the process says of its end; nothing in it may look like a crash."""
    text = capfd.readouterr().err
    assert 'Traceback' not in text
    assert 'ignored' not in text
    return [line for line in text.splitlines() if line.startswith('fatal')]


def node_that(acts: Callable[[], object], name: str = 'acting') -> Callable[[], Node]:
    def make() -> Node:
        node = Node(name)
        node.create_timer(0.001, acts)
        node.create_service(Trigger, f'{name}/service', lambda _, response: response)
        return node

    return make


def ask(*numbers: int) -> None:
    for number in numbers or (signal.SIGINT,):
        os.kill(os.getpid(), number)


def ask_twice() -> None:
    ask(signal.SIGINT, signal.SIGINT)


def fail() -> None:
    raise RuntimeError('something\nbroke')


# A signal interrupts rclpy while it takes a message; a conversion, before the context is down.
INTERRUPTED = (rclpy.shutdown, fail), (ask, fail)
ASKED = [(partial(ask, number),) for number in SIGNALS]
ENDS = *ASKED, (ask_twice,), (rclpy.shutdown,), (fail,)


@pytest.mark.parametrize('acts', [*ENDS, *INTERRUPTED])
def test_the_end_of_a_node_that_runs(capfd, acts):
    broken = acts == (fail,)
    assert run(node_that(lambda: [act() for act in acts])) == broken
    assert told(capfd) == ['fatal: RuntimeError: something broke'] * broken


def asked_in_a_finaliser() -> Node:
    """Make a node; KeyboardInterrupt, raised there as Python does, would be ignored."""
    type('Finalised', (), {'__del__': lambda self: ask_twice()})()
    return Node('starting')


def invalid() -> Node:
    raise InvalidProblem('there is\nno such problem')


@pytest.mark.parametrize(
    ('make', 'args', 'code', 'says'),
    [
        (asked_in_a_finaliser, [], 0, ''),
        (invalid, [], 2, 'fatal: there is no such problem'),
        (invalid, ['--ros-args', '--params-file', '/nowhere.yaml'], 2, '/nowhere.yaml'),
        (Planner, ['--help'], 2, "argument '--help' is unknown: must follow"),
        (Planner, ['-p', 'method:=smooth'], 2, "argument '-p' is unknown: must follow --ros-args"),
        (Planner, ['--ros-args', '-p', 'method:=foo', '--', 'bar'], 2, "argument 'bar' is"),
        (Planner, ['--ros-args', '-p', 'method:=foo'], 2, "'method' = 'foo' is not allowed: must"),
        (
            TrackerNode,
            ['--ros-args', '-p', 'planner_service:="a plan"'],
            2,
            "'planner_service' = 'a plan' is not allowed: Invalid topic name: topic name must not",
        ),
    ],
)
def test_the_end_of_a_node_that_is_made(capfd, make, args, code, says):
    assert run(make, args) == code
    lines = told(capfd)
    assert len(lines) == bool(says)
    assert says in ''.join(lines)


def test_signals_while_it_leaves_are_let_pass(monkeypatch, capfd):
    def ask_and_ignore() -> None:
        ask_twice()
        ignore_signals()
        ask_twice()

    monkeypatch.setattr(runtime, 'ignore_signals', ask_and_ignore)
    assert run(node_that(ask)) == 0
    assert told(capfd) == []


@pytest.mark.parametrize(('later', 'whole'), [(1.9, True), (2.1, False)])
def test_only_a_signal_that_comes_long_after_the_first_interrupts(ros, later, whole):
    done = []

    def acts() -> None:
        ask()
        ros.step_to(ros.now + round(later * 1e9))
        ask()
        done.append('whole')

    assert run(node_that(acts)) == 0
    assert bool(done) is whole


def test_a_signal_does_not_interrupt_what_the_executor_of_a_demo_does(ros, monkeypatch, tmp_path):
    """Rclpy prints a traceback for every task and future that is left half made."""
    done = []

    def spin_once(_: SingleThreadedExecutor, timeout_sec: float) -> None:
        ask()
        ros.step_to(ros.now + math.ceil(1e9 * timeout_sec))
        done.append('whole')

    monkeypatch.setattr(SingleThreadedExecutor, 'spin_once', spin_once)
    monkeypatch.setattr(demo.NodeProcesses, 'start', lambda *_: None)
    scene = demo.make_scene('pendulum', None)
    with pytest.raises(Interrupted), interruptible():
        demo._conduct(scene, tmp_path, Progress(quiet=True))
    assert done == ['whole']


def test_others_see_at_once_that_it_has_gone(ros):
    """Not when the middleware gives it up, 20 s later."""
    # To an observer that has not heard of the end of one with the same identifier it never begins.
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros.domain)
    observer = rclpy.create_node('observer', context=context)
    seen: list[int] = []

    def look() -> None:
        seen.append(observer.count_services('/gone/service'))
        if seen[-1]:
            ask()

    try:
        assert run(node_that(look, 'gone')) == 0
        assert seen[-1] == 1
        assert ros.meet(lambda: not observer.count_services('/gone/service'))
    finally:
        observer.destroy_node()
        rclpy.shutdown(context=context)


def test_what_was_loaded_is_not_looked_through_for_garbage():
    """That takes .1 s with what a tracker loads, in which it sends no command."""
    before, frozen = gc.get_freeze_count(), list[int]()
    loaded = [list[int]() for _ in range(1000)]

    def look() -> None:
        frozen.append(gc.get_freeze_count())
        ask()

    assert run(node_that(look)) == 0
    assert frozen[0] >= before + len(loaded)
