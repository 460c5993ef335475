# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Node `tracker`: keeps a plant on the active trajectory and holds it at the goal.

The phases and rules are those of `tdm_planner.tracking.tracker`; here they meet topics, a clock,
the planner's service and the diagnostics.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tdm_planner.arrays import Array
from tdm_planner.exceptions import Failure, InvalidProblem, one_line
from tdm_planner.nodes.clocks import MotionClock, pacing_clock, RateWatch
from tdm_planner.nodes.diagnostics import PublisherCount, Report
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.measured_state import MeasuredState
from tdm_planner.nodes.messages import command_message, from_wire, joint_states, LATCHED, QUEUE
from tdm_planner.nodes.reading import Level, nanoseconds_of, read_plan
from tdm_planner.nodes.ros_parameters import WARNING_PERIOD
from tdm_planner.nodes.runtime import check_topic, run
from tdm_planner.nodes.tracker_plans import PlanIntake, TrackerStatus
from tdm_planner.parameters import build, ParameterSpec, specifications
from tdm_planner.tracking.motion import Action, Command, Phase, Steps, TrajectoryRejected
from tdm_planner.tracking.tracked_plants import tracker_type
from tdm_planner.tracking.tracker import BREAKDOWN, TrajectoryTracker
from tdm_planner.trajectory import NANOSECOND
from trajectory_msgs.msg import JointTrajectory

DRAIN_TIME = 0.1  # s for the command that switches the actuators off to arrive
FIRST_STATE = 5.0  # s from activation until a first state must have come: discovery takes three
LONGEST_PLANNING = 10.0  # s after which an unanswered request for a plan is dropped

_EXAMINING = 0.3  # of the time, for plans
_WAITING = 'waiting for the first state'

KIND = ParameterSpec(
    name='kind',
    value_type=str,
    default='pendulum',
    description='kind of plant to track: pendulum, robot, or a stated problem (module:Class)',
    read_only=True,
)


class TrackerNode(ManagedNode):
    """Tracks `trajectory` from the measured state; publishes `joint_command`, `tracking_error`."""

    def __init__(self, **options: Any) -> None:
        super().__init__('tracker', 'tracking', {KIND.name: KIND}, **options)
        self.type = tracker_type(self.parameter_values[KIND.name])
        self.declare(specifications(self.type.parameters))
        check_topic(self.parameter_values['planner_service'], "parameter 'planner_service'")
        self.warn_of_unknown_overrides()
        self._time = MotionClock(self, self._on_clock_step)
        self._accepted = self._rejected = self._states_ignored = 0
        self._deviation = self._delay = 0.0
        self._asked_at = -np.inf  # or answered
        self._answer: Future | None = None
        self.bring_up()

    # Lifecycle.

    def configure(self) -> None:
        """Listen to plan and state."""
        self.tracker = self._make_tracker(self.parameter_values)
        self._command_publisher = self.create_publisher(JointState, 'joint_command', QUEUE)
        self._error_publisher = self.create_publisher(JointState, 'tracking_error', QUEUE)
        parameters = self.tracker.parameters
        self._planner = self.create_client(Trigger, parameters.planner_service)
        self._status = TrackerStatus(self)
        self._intake = self._new_intake()
        self._planners = PublisherCount(
            self,
            'trajectory',
            'the tracker follows the plan that starts last; run only one of them',
            self._diagnostics.update,
        )
        self.create_subscription(
            JointTrajectory, 'trajectory', self._on_trajectory, LATCHED, raw=True
        )
        self._measured = MeasuredState(
            self,
            self._time,
            self.type.kind,
            '',
            self._on_state,
            self._ignore_state,
            lambda: self.tracker.parameters.state_timeout,
        )
        self._sources = self._measured.count_sources(self._diagnostics.update)

    def activate(self) -> None:
        """Begin like a node that was just started; a plan received meanwhile is examined."""
        self.tracker = self._make_tracker(self.parameter_values)
        self._last, self._rejection = (Phase.IDLE, ''), ''  # phase and problem
        self._latest_rejected = False
        self._awaits_until = time.monotonic() + FIRST_STATE
        clock, parameters = pacing_clock(self), self.tracker.parameters
        self._rate = RateWatch(parameters.rate, clock)
        self._timer = self.create_timer(parameters.interval, self._on_tick, clock=clock)
        self._status.begin()
        newest = self._measured.newest
        if newest is None:
            self.get_logger().info(_WAITING)
        else:
            self._on_state(*newest)

    def deactivate(self) -> None:
        """Switch the actuators off by a last command, and drop the active plan."""
        self.destroy_timer(self._timer)
        self._intake = self._new_intake()
        self._send(self.tracker.nothing, self.get_clock().now().to_msg())
        self._status.cancel()
        time.sleep(DRAIN_TIME)

    def _new_intake(self) -> PlanIntake:
        return PlanIntake(self._look_at, _EXAMINING * self.tracker.parameters.interval)

    def cleanup(self) -> None:
        """Forget what was received."""
        self._answer = None

    # Parameters.

    def _make_tracker(self, values: Mapping[str, Any]) -> TrajectoryTracker:
        try:
            return self.type.make_tracker(build(self.type.parameters, values))
        except BREAKDOWN as error:
            raise InvalidProblem(
                "parameters 'plant.*', 'limits.*', 'weights.*', 'feedback.*', 'estimator.*' lie "
                f'too far apart to be computed with: {one_line(error)}'
            ) from None

    def check_values(self, values: Mapping[str, Any]) -> None:
        """Reject values that contradict each other, or do not fit the active plan."""
        made = self._make_tracker(values)
        if self.configured:
            try:
                made.adopt(self.tracker)
            except TrajectoryRejected as error:
                raise InvalidProblem(f'the active plan could not be followed: {error}') from None
        self._checked = made

    def values_changed(self) -> None:
        """Apply the changed parameters, without a jump of phase or trajectory."""
        if self.configured:
            self.tracker = self._checked
            self._intake.begin_anew()
        super().values_changed()

    # Messages. A state passes MeasuredState._receive and _on_state; then _on_tick and _send.

    def _on_clock_step(self, step: float) -> None:
        self.get_logger().warning(f'the clock was set by {step:+.3g} s: the motion goes on')

    def _on_state(self, state: Array, at: float) -> None:
        """Observe a state (nx,) of the instant [s]; ignore one from the future."""
        self._delay, longest = self._time.now() - at, self.tracker.parameters.state_timeout
        if self._delay <= longest:
            self._awaits_until = 0.0
        if -self._delay > longest:
            self._ignore_state(
                f'its stamp lies {-self._delay:.3g} s in the future: are the clocks synchronised?'
            )
            return
        if self.active:
            try:
                self.tracker.observe(state, at)
            except Exception as error:  # noqa: B902
                self._ignore_state(self._sentence_of(error))

    def _ignore_state(self, reason: str) -> None:
        self._states_ignored += 1
        self.get_logger().warning(f'state ignored: {reason}', throttle_duration_sec=WARNING_PERIOD)

    def _on_trajectory(self, data: bytes) -> None:
        """Receive a trajectory; it waits while the node is inactive, unless it begins at once."""
        try:
            stamp = from_wire(data, Header).stamp  # what follows is not looked at
            if not (self.active or nanoseconds_of(stamp)):
                raise InvalidProblem(
                    'its stamp is zero, it begins when it comes: the tracker must be active then'
                )
            self._intake.waiting = stamp, data
        except InvalidProblem as error:
            self._reject(str(error))
        if self.active and self._time.runs:
            self._intake.go_on()

    def _look_at(self, stamp: Time, data: bytes) -> Steps[bool]:
        """
        Accept a plan, and return whether; ignore the active one, repeated by a restarted planner.

        What is wrong with a plan that is rejected is told.
        """
        begins = nanoseconds_of(stamp) or int(self.get_clock().now().nanoseconds)
        accepted = False
        try:
            message = from_wire(data, JointTrajectory)
            if not message.points:  # the planner has dropped its plan
                return False
            trajectory = read_plan(self.type.kind, message)
            begins += round(float(trajectory.times[0]) / NANOSECOND)
            now = self._time.now()
            start = self._time.instant_of(stamp) + float(trajectory.times[0])
            if self._status.follows(trajectory, begins, self.tracker):
                return False
            self._check_latest(start)
            yield from self.tracker.accepting(trajectory, start, now)
        except Exception as error:  # noqa: B902
            self._reject(self._sentence_of(error))
            self._status.rejected(begins, self.tracker)
        else:
            accepted, self._latest_rejected = True, False
            self._accepted += 1
            self._status.accepted(trajectory, begins, data)
            self.get_logger().info(
                f'trajectory of {trajectory.duration:.3f} s accepted, '
                f'starts in {start - self._time.now():.3f} s'
            )
            if told := self.tracker.warning:
                self.get_logger().warning(told, throttle_duration_sec=WARNING_PERIOD)
        self._diagnostics.update()
        return accepted

    def _reject(self, reason: str) -> None:
        """Report why a trajectory is rejected."""
        self._rejected, self._latest_rejected = self._rejected + 1, True
        self._rejection = f'trajectory rejected: {reason}'
        self.get_logger().error(self._rejection)

    def _sentence_of(self, error: Exception) -> str:
        """Return an error as a sentence; of a fault of the program, log the traceback."""
        failure = Failure.of(error)
        if failure.trace:
            self.get_logger().error(str(failure), throttle_duration_sec=WARNING_PERIOD)
        return failure.sentence

    def _check_latest(self, start: float) -> None:
        """
        Of several planners' plans, accept only the one that starts last.

        All trackers of a formation then follow the same planner, in whatever order plans arrive.
        """
        newest = self.tracker.newest
        if newest is not None and start < newest.start and self._planners.look() > 1:
            raise TrajectoryRejected(
                f'it starts {newest.start - start:.3g} s before the newest plan; with '
                f'{self._planners.count} planners the tracker follows the latest start'
            )

    # Commands.

    def _on_tick(self) -> None:
        self._rate.tick()
        if self.tracker.is_set_back(self._time.now()):  # what is examined is of another time
            self._intake = self._new_intake()
        if self._time.runs:
            self._intake.tick()
        now, stamp = self._time.now(), self.get_clock().now().to_msg()
        try:
            command = self.tracker.command(now)
        except Exception as fault:  # noqa: B902
            # The actuators must be off now, not when the node has died.
            command = self.tracker.break_down(now, self._sentence_of(fault))
        self._send(command.control, stamp)
        motion = self.tracker.current
        if command.action is not None and motion is not None:
            self._deviation = self.tracker.deviation(motion, command.action.error)
            self._tell_error(command.action, stamp)
        self._note_changes(command)
        self._status.update(self.tracker)
        if command.phase is Phase.RECOVERING and self.tracker.wants_plan:
            self._ask_for_plan()

    def _send(self, control: Array, stamp: Time) -> None:
        message = command_message(self.type.kind, control)
        message.header.stamp = stamp
        self._command_publisher.publish(message)

    def _tell_error(self, action: Action, stamp: Time) -> None:
        """Publish the deviation of the states, and the feedback within the command as efforts."""
        kind = self.type.kind
        names, values = (*kind.state_names, *kind.control_names), (*action.error, *action.feedback)
        message = joint_states(kind.joints, dict(zip(names, map(float, values), strict=True)))
        message.header.stamp = stamp
        self._error_publisher.publish(message)

    @property
    def _awaits_state(self) -> bool:
        """Whether a first state that is not old is still expected."""
        return time.monotonic() < self._awaits_until

    def _note_changes(self, command: Command) -> None:
        problem = '' if self._awaits_state else command.problem
        if self._last == (command.phase, problem):
            return
        self._last = command.phase, problem
        text = command.phase.value + (f': {problem}' if problem else '')
        # One call site a severity: rclpy forbids a call site to change its severity.
        if problem:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)
        self._diagnostics.update()

    def _ask_for_plan(self) -> None:
        """Request a new plan, one at a time; others may ask for `replan.interval` in between."""
        replan = self.tracker.parameters.replan
        now = time.monotonic()
        waiting = self._answer is not None and now - self._asked_at < LONGEST_PLANNING
        if waiting or now - self._asked_at < replan.interval:
            return
        self._asked_at = now
        if self._answer is not None:  # it would be kept for ever
            self._planner.remove_pending_request(self._answer)
            self._answer = None
        if not self._planner.service_is_ready():
            self.get_logger().warning(
                f'no planner serves {self._planner.srv_name}: cannot request a new plan',
                throttle_duration_sec=WARNING_PERIOD,
            )
            return
        self.get_logger().info('requesting a new plan')
        self._answer = self._planner.call_async(Trigger.Request())
        self._answer.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Future) -> None:
        self._answer, self._asked_at = None, time.monotonic()
        response = answer.result()
        if response is not None and not response.success:
            self.get_logger().warning(f'no new plan: {response.message}')

    # Diagnostics.

    def report(self) -> Report:
        """Return phase, deviation, ages and counts."""
        phase, problem = self._last
        slow = self._rate.problem()
        rejection = self._rejection if self._latest_rejected else ''
        several = [count.warning for count in (self._planners, *self._sources)]
        told = [self._time.problem, rejection, *several, self.tracker.warning]
        told = [*filter(None, told), *([f'commands at {slow}'] if slow else [])]
        level = Level.ERROR if problem else Level.WARN if told else Level.OK
        doing = problem or (_WAITING if self._awaits_state else '')
        message = '; '.join([phase.value + (f': {doing}' if doing else ''), *told])
        now, motion = self._time.now(), self.tracker.current or self.tracker.pending
        figures: dict[str, Any] = {
            'phase': phase.value,
            'state age [s]': self.tracker.state_age(now),
            'delay of states [s]': self._delay,
            **self.tracker.found,
            'deviation': self._deviation,
            'time since start [s]': 'none' if motion is None else now - motion.start,
            'trajectories accepted': self._accepted,
            'trajectories rejected': self._rejected,
            'last rejection': self._rejection or 'none',
            'planners': self._planners.count,
            'gains computed in [s]': self._intake.took,
            'rate [Hz]': self._rate.measured(),
            'states ignored': self._states_ignored,
        }
        return Report(level, message, figures)


main = partial(run, TrackerNode)

if __name__ == '__main__':
    sys.exit(main())
