# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A client of the planner: plans as trajectories, failures as exceptions.

    with PlanClient('pendulum') as client:
        plan = client.plan_with({'goal.turns': 1})
        torque = plan.trajectory.control('torque')

What the service answers is a plan's figures; the motion comes as messages. The client finds those
that belong to the answer by `plan_summary`, and reads them with the joints that it names.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, partial
import json
import threading
import time
from typing import Any, TypeVar
import uuid

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from tdm_planner.exceptions import ERRORS, InvalidProblem, NoAnswer, TdmError
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.reading import nanoseconds_of, read_plan
from tdm_planner.nodes.runtime import check_namespace
from tdm_planner.parameters import flatten, shown
from tdm_planner.plant_kind import PlantKind
from tdm_planner.trajectory import joined, SECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory

T = TypeVar('T')

_BY_CODE: Mapping[str, type[TdmError]] = {error.code: error for error in ERRORS}
_REMEMBERED = 64  # summaries of plans, and motions of all vehicles
_LATCHED = QoSProfile(depth=_REMEMBERED, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_POLL = 0.05  # s between looks at what comes without a callback


@dataclass(frozen=True, eq=False)
class PlanResult:
    """
    A plan that was made and published.

    `start` is the instant at which the motion starts [ns of the planner's clock], `trajectories`
    are the motions by vehicle; times in s, SI units. `parameters` are those it was made with.
    """

    plan_id: int
    duration: float
    cost: float | None
    penalty: float | None
    solve_time: float
    evaluations: int
    summary: str
    start: int
    trajectories: Mapping[str, Trajectory]
    parameters: Mapping[str, Any]

    @cached_property
    def trajectory(self) -> Trajectory:
        """Return the motion; of several vehicles all, on common instants as ``name.state``."""
        return joined(self.trajectories)


class PlanClient:
    """
    Asks the planner in `namespace` for plans and waits for them; to be used by one thread.

    Without a `node` the client makes one and spins it while it waits: it may be used anywhere, in
    callbacks too, and must be closed (``with``). If an executor spins `node`, wait for plans in
    another thread than that executor's.

    Raise InvalidProblem if `namespace` cannot be one.
    """

    def __init__(self, namespace: str = '', *, node: Node | None = None) -> None:
        self._prefix = f'{namespace.rstrip("/")}/' if namespace else ''
        check_namespace(namespace, 'namespace')
        self._context: rclpy.Context | None = None
        if node is None:
            self._context = rclpy.Context()
            rclpy.init(context=self._context)
            node = Node(
                f'plan_client_{uuid.uuid4().hex[:8]}',
                context=self._context,
                start_parameter_services=False,
                enable_rosout=False,
            )
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._news = threading.Event()
        self._summaries: deque[dict[str, Any]] = deque(maxlen=_REMEMBERED)  # the newest last
        self._newest: tuple[Mapping[str, Any], PlanResult | None] = {}, None
        self._messages: deque[tuple[str, JointTrajectory]] = deque(maxlen=_REMEMBERED)  # by topic
        self._subscriptions: dict[str, Any] = {}
        self._client = node.create_client(
            SetParametersAtomically, f'{self._prefix}plan_with', qos_profile=SERVICE
        )
        self._subscribe('plan_summary', String, self._on_summary)

    def __enter__(self) -> PlanClient:
        """Return the client."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the client."""
        self.close()

    def close(self) -> None:
        """Take away what the client has made."""
        self._executor.shutdown()
        if self._context is not None:
            self._node.destroy_node()
            rclpy.try_shutdown(context=self._context)
            return
        self._node.destroy_client(self._client)
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)

    def wait(self, timeout: float = 20.0) -> None:
        """
        Wait until there is a planner, at most `timeout` s.

        Raises
        ------
        NoAnswer
            If none was found.

        """
        self._wait(self._connected, timeout, f'no planner serves {self._client.service_name}')

    def plan(self, *, timeout: float = 20.0) -> PlanResult:
        """Plan with the planner's own parameters; see `plan_with`."""
        return self.plan_with(timeout=timeout)

    def plan_with(
        self,
        parameters: Mapping[str, Any] | None = None,
        /,
        *,
        timeout: float = 20.0,
        **more: Any,
    ) -> PlanResult:
        """
        Plan with `parameters` (and `more`) for this request alone, and wait for the plan.

        Parameters
        ----------
        parameters, more
            Values by name: the problem's, ``solver.*`` and ``start.*``; None unsets one. Groups
            may be mappings, as in a parameter file.
        timeout
            Longest wait [s] for the planner, its answer and the messages together.

        Raises
        ------
        TdmError
            Why there is no plan: the error of the planner's ``code`` (`InvalidProblem`, `NoState`,
            `Infeasible`, `DeadlineExceeded`, `VerificationFailed`, `Busy`, `Inactive`,
            `PlannerFault`), or `NoAnswer` when the time has passed. ``reason`` is the sentence.

        """
        end = time.monotonic() + timeout
        self.wait(timeout)
        asked_for = flatten({**(parameters or {}), **more})
        given = [_message(name, value) for name, value in asked_for.items()]
        asked = self._client.call_async(SetParametersAtomically.Request(parameters=given))
        asked.add_done_callback(lambda _: self._news.set())
        try:
            silent = f'{self._client.service_name} did not answer within {timeout:g} s'
            self._wait(asked.done, end - time.monotonic(), silent)
        finally:
            self._client.remove_pending_request(asked)
        result = asked.result().result
        answer = json.loads(result.reason)
        if not result.successful:
            raise _BY_CODE[answer['code']](answer['reason'])

        def found() -> PlanResult | None:
            told = [s for s in list(self._summaries) if answer.items() <= s.items()]
            return self._read(told[-1]) if told else None

        missing = f'the messages of plan {answer["plan_id"]} did not come within {timeout:g} s'
        return self._wait(found, end - time.monotonic(), missing)

    @property
    def newest(self) -> PlanResult | None:
        """
        Return the newest plan that was published, whoever asked for it; None before there is one.

        It is known as far as the node has been served.
        """
        told = self._summaries[-1] if self._summaries else self._newest[0]
        if told is not self._newest[0] and (found := self._read(told)) is not None:
            self._newest = told, found
        return self._newest[1]

    # What was received.

    def _subscribe(self, topic: str, kind: Any, callback: Callable[[Any], None]) -> None:
        def take(message: Any) -> None:
            callback(message)
            self._news.set()

        if topic not in self._subscriptions:
            self._subscriptions[topic] = self._node.create_subscription(
                kind, f'{self._prefix}{topic}', take, _LATCHED
            )

    def _connected(self) -> bool:
        topic = self._subscriptions['plan_summary'].topic_name
        return self._node.count_publishers(topic) > 0 and bool(self._client.service_is_ready())

    def _on_summary(self, message: String) -> None:
        try:
            summary = json.loads(message.data)
            topics = ['trajectory', *(f'{vehicle}/trajectory' for vehicle in summary['vehicles'])]
            for topic in topics:
                self._subscribe(topic, JointTrajectory, partial(self._on_trajectory, topic))
            self._summaries.append(summary)
        except (ValueError, TypeError, KeyError, RecursionError, NameValidationException):
            return  # not a planner's

    def _on_trajectory(self, topic: str, message: JointTrajectory) -> None:
        self._messages.append((topic, message))

    def _read(self, summary: Mapping[str, Any]) -> PlanResult | None:
        """Return the plan that a summary tells of; None until all its motions have come."""
        start = summary['stamp']['sec'] * SECOND + summary['stamp']['nanosec']
        # A list, in one step: another thread may serve the node.
        came = list(self._messages)
        received = {topic: m for topic, m in came if nanoseconds_of(m.header.stamp) == start}
        trajectories = {}
        for vehicle, told in summary['vehicles'].items():
            message = received.get(f'{vehicle}/trajectory', received.get('trajectory'))
            if message is None:
                return None
            trajectories[vehicle] = read_plan(PlantKind.from_dict(told), message, rated=True)
        return PlanResult(
            **{f.name: summary[f.name] for f in fields(PlanResult) if f.name in summary},
            start=start,
            trajectories=trajectories,
        )

    # Waiting.

    def _wait(self, condition: Callable[[], T | None], timeout: float, otherwise: str) -> T:
        """Serve the node, or wait for who serves it, until `condition` holds; NoAnswer if not."""
        end = time.monotonic() + timeout
        while not (found := condition()):
            left = end - time.monotonic()
            if left <= 0.0:
                raise NoAnswer(otherwise)
            if self._node.executor in (None, self._executor):
                rclpy.spin_once(self._node, executor=self._executor, timeout_sec=min(left, _POLL))
            else:
                self._news.wait(min(left, _POLL))
                self._news.clear()
        return found


def _message(name: str, value: Any) -> Any:
    """
    Return a parameter as a message; numpy's numbers, and lists of mixed numbers, are taken.

    Raise InvalidProblem for a value that no parameter can have.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple) and any(isinstance(item, float) for item in value):
        value = [float(item) for item in value]
    try:
        return Parameter(name, value=value).to_parameter_msg()
    except TypeError:
        raise InvalidProblem(
            f"parameter '{name}' = {shown(value)} is not allowed: must be a number, a string, "
            'true or false, or a list of values of one of these kinds'
        ) from None
