# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
What the simulated plants have in common as nodes: real time, commands, services, diagnostics.

A plant is integrated up to the present by time stamps whenever something happens (timer, command,
service), so that late timers delay messages but never slow down or speed up the motion.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.diagnostics import Diagnostics, Level, Report
from tdm_planner.nodes.markers import lifetime_at, MARKER_DEPTH
from tdm_planner.nodes.motion_clock import MotionClock, pacing_clock
from tdm_planner.nodes.qos import NEWEST
from tdm_planner.nodes.rate_watch import RateWatch, seconds_by
from tdm_planner.nodes.ros_parameters import ParameterNode
from tdm_planner.nodes.sole_publisher import SolePublisher
from tdm_planner.parameters import (
    build,
    parameter,
    ParameterSpec,
    POSITIVE,
    Range,
    SEED,
    specifications,
    Validated,
)
from tdm_sim.clock_source import ClockSource
from tdm_sim.commands import MalformedCommand
from tdm_sim.simulation import PlantSetup, SimulatedPlant
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

LONGEST_CATCH_UP = 0.1  # s; what a process stalled for longer leaves out, so that it can recover
WARNING_PERIOD = 2.0  # s, the least time between warnings of a kind

_SHARE = Range(0.0, 1.0, upper_open=True)


@dataclass(frozen=True)
class SimulationParameters(Validated):
    """What every simulated plant can be told; subclasses add the plant's own."""

    rate: float = parameter(
        200.0,
        'rate of the published states',
        unit='Hz',
        allowed=Range(0.1, 1000.0),
        read_only=True,
    )
    real_time_factor: float = parameter(
        1.0,
        'speed of the simulated motion relative to the clock; with publish_clock, of that clock '
        'relative to real time',
        allowed=Range(0.0, 100.0, lower_open=True),
    )
    publish_clock: bool = parameter(
        False,
        'drive /clock, for other nodes with use_sim_time; one node alone must do so',
        read_only=True,
    )
    clock_followers: list[str] = parameter(
        ['joint_command'],
        'topics of commands or joint states whose publishers the clock waits for when they fall '
        'behind',
        read_only=True,
    )
    command_timeout: float = parameter(
        0.1,
        'simulated time without a command after which the actuators are switched off',
        unit='s',
        allowed=POSITIVE,
    )
    mismatch: float = parameter(
        0.0,
        'largest relative error put on every physical constant, at random (0.05 is 5 %)',
        allowed=_SHARE,
    )
    mismatch_seed: int = parameter(
        0, 'seed of the mismatch: the same seed gives the same plant', allowed=SEED
    )
    seed: int = parameter(
        0,
        'seed of measurement noise, command loss and push directions',
        allowed=SEED,
        read_only=True,
    )


@dataclass(frozen=True)
class MarkerParameters(Validated):
    """How the plant is drawn, while somebody looks."""

    rate: float = parameter(
        25.0,
        'rate of the markers while somebody listens; 0 switches them off',
        unit='Hz',
        allowed=Range(0.0, 100.0),
    )
    trail: float = parameter(
        1.0, 'time for which the travelled trail is shown', unit='s', allowed=Range(0.0, 600.0)
    )


class PlantNode(ParameterNode):
    """
    A simulated plant in real time; subclasses say which plant and how it looks as messages.

    Subscribes `joint_command`, publishes measured states, `plant_markers` and `/diagnostics`,
    serves `reset` and `push`. Subclasses declare a group `markers` of `MarkerParameters`. Changed
    parameters act at once, without a jump of the state (`initial.*` at `reset`).

    Raises
    ------
    InvalidProblem
        If the parameters given at the start do not make a plant together.

    """

    def __init__(
        self,
        name: str,
        parameters: type[SimulationParameters],
        first: Mapping[str, ParameterSpec] = MappingProxyType({}),
        **options: Any,
    ) -> None:
        super().__init__(name, first, **options)
        self._parameters_type = self.parameters_of(parameters)
        self.declare(specifications(self._parameters_type))
        self.warn_of_unknown_overrides()
        self.parameters: Any = build(self._parameters_type, self.parameter_values)
        self.simulation = SimulatedPlant(self.make_setup(self.parameters), self.parameters.seed)
        self._clock_source = self._make_clock_source()
        self._time = MotionClock(self)
        self._last = self._time.now()
        self._has_time = self._time.runs
        self._left_out = 0.0
        self._published = self._accepted = self._refused = self._pushes = 0
        self._warned_timeouts = 0
        self._drawn = 0  # instant [ns]
        self._markers = self.create_publisher(MarkerArray, 'plant_markers', MARKER_DEPTH)
        self.make_publishers()
        self._diagnostics = Diagnostics(self, 'simulation', self._report)
        self._clocks = None if self._clock_source is None else self._watch_for_other_clocks()
        self.create_subscription(JointState, 'joint_command', self._on_command, NEWEST)
        self.create_service(Trigger, 'reset', self._on_reset)
        self.create_service(Trigger, 'push', self._on_push)
        self._jump = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._on_clock_jump,
        )
        self._timer = self._make_timer()

    def parameters_of(self, base: type[SimulationParameters]) -> type[SimulationParameters]:
        """Return the dataclass of the parameters, once the `first` ones are known."""
        return base

    def _make_clock_source(self) -> ClockSource | None:
        if not self.parameters.publish_clock:
            return None
        given = self.parameters
        return ClockSource(self, 1.0 / given.rate, given.real_time_factor, given.clock_followers)

    def _watch_for_other_clocks(self) -> SolePublisher:
        return SolePublisher(
            self,
            CLOCK_TOPIC,
            'the time of those who follow it leaps; let only one of them drive it',
            self._diagnostics.update,
            'nodes',
        )

    def _make_timer(self) -> Timer:
        period = 1.0 / self.parameters.rate
        clock = pacing_clock(self)
        if self._clock_source is not None:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            period /= self._clock_source.speed
        self._rate = RateWatch(1.0 / period, seconds_by(clock))
        return self.create_timer(period, self._on_timer, clock=clock)

    @abstractmethod
    def make_setup(self, parameters: Any) -> PlantSetup:
        """Return the plant, its limits and its disturbances as `parameters` say."""

    @abstractmethod
    def make_publishers(self) -> None:
        """Create the publishers of the states."""

    @abstractmethod
    def publish_state(self, measured: Array, stamp: Any) -> None:
        """Publish the state (nx,) as measured at `stamp` (builtin_interfaces/Time)."""

    @abstractmethod
    def draw(self, measured: Array, now: Time, lifetime: float) -> MarkerArray:
        """Return the plant in the state (nx,) measured at `now`, visible for `lifetime` [s]."""

    def follow(self, measured: Array, now: Time) -> None:
        """Remember the state (nx,) for the trail."""

    def moved_elsewhere(self) -> None:
        """Forget the trail: the plant was put elsewhere."""

    @abstractmethod
    def read_command(self, message: JointState) -> Array:
        """Return the controls (nu,) of a command; raises MalformedCommand."""

    @abstractmethod
    def push_effect(self) -> tuple[Callable[[Array], Array], str]:
        """Return what one push of `disturbance.impulse` does to a state, and a description."""

    @abstractmethod
    def conditions(self) -> tuple[list[str], dict[str, Any]]:
        """Return warnings about the plant's state, and figures for the diagnostics."""

    def check_values(self, values: Mapping[str, Any]) -> None:
        """Refuse values that do not make a plant together."""
        self.make_setup(build(self._parameters_type, values))

    def values_changed(self, names: frozenset[str]) -> None:
        """Let changed parameters act from now on."""
        self.advance()
        self.parameters = build(self._parameters_type, self.parameter_values)
        self.simulation.setup = self.make_setup(self.parameters)
        source, speed = self._clock_source, self.parameters.real_time_factor
        if source is not None and source.speed != speed:
            source.advance()
            source.speed = speed
            self.destroy_timer(self._timer)
            self._timer = self._make_timer()

    def advance(self) -> Time:
        """Integrate up to the present and return its stamp."""
        now = self._time.now()
        stamp: Time = self.get_clock().now()
        if not self._has_time:  # simulated time may begin anywhere
            self._has_time, self._last = self._time.runs, now
        elapsed, self._last = now - self._last, now
        if elapsed > LONGEST_CATCH_UP:
            self._left_out += elapsed - LONGEST_CATCH_UP
            elapsed = LONGEST_CATCH_UP
        if elapsed > 0.0:
            # With a clock of its own the motion runs as fast as that clock.
            own = self._clock_source is not None
            self.simulation.step(elapsed * (1.0 if own else self.parameters.real_time_factor))
        return stamp

    def _on_timer(self) -> None:
        self._rate.tick()
        if self._clock_source is not None:
            self._clock_source.advance()
        now = self.advance()
        measured = self.simulation.measure()
        self.publish_state(measured, now.to_msg())
        self._published += 1
        self._show(measured, now)
        if self.simulation.timeouts > self._warned_timeouts:
            self._warned_timeouts = self.simulation.timeouts
            self.get_logger().warning(
                f'no command for {self.parameters.command_timeout:g} s (command_timeout): '
                'actuators off',
                throttle_duration_sec=WARNING_PERIOD,
            )

    def _show(self, measured: Array, now: Time) -> None:
        rate = self.parameters.markers.rate
        self.follow(measured, now)
        elapsed = now.nanoseconds - self._drawn
        if rate == 0.0 or 0 <= elapsed * rate < 1e9 or not self._markers.get_subscription_count():
            return
        self._drawn = now.nanoseconds
        self._markers.publish(self.draw(measured, now, lifetime_at(rate)))

    def _on_command(self, message: JointState) -> None:
        self.advance()
        try:
            self.simulation.command(self.read_command(message))
        except MalformedCommand as error:
            self._refused += 1
            self.get_logger().warning(
                f'joint_command ignored: {error}', throttle_duration_sec=WARNING_PERIOD
            )
            return
        self._accepted += 1

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.advance()
        self.simulation.reset()
        self.moved_elsewhere()
        response.success = True
        response.message = 'back in the initial state'
        return response

    def _on_push(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.advance()
        effect, description = self.push_effect()
        self.simulation.push(effect)
        self._pushes += 1
        self.get_logger().info(description)
        response.success = True
        response.message = description
        return response

    def _on_clock_jump(self, _: Any) -> None:
        # The motion goes on from the simulated clock's new time as if nothing had happened.
        self._last = self._time.now()

    def _report(self) -> Report:
        warnings, figures = self.conditions()
        errors = list(self.invalid_overrides.values())
        if self._left_out > 0.0:
            warnings = [*warnings, f'{self._left_out:.3g} s left out: the process was stalled']
        slow = self._rate.problem()
        if slow:
            warnings = [*warnings, f'states at {slow}']
        if self._clocks is not None and self._clocks.warning:
            warnings = [*warnings, self._clocks.warning]
        level, message = Level.OK, 'driven' if self.simulation.commanded else 'no command'
        if self.simulation.breakdowns:
            errors.append(
                f'reset {self.simulation.breakdowns} times: the motion could not be integrated'
            )
        if errors or warnings:
            level = Level.ERROR if errors else Level.WARN
            message = '; '.join([*errors, *warnings])
        return Report(
            level,
            message,
            {
                'simulated time [s]': self.simulation.time,
                'time left out [s]': self._left_out,
                'rate [Hz]': self._rate.measured(),
                'states published': self._published,
                'commands accepted': self._accepted,
                'commands refused': self._refused,
                'command time-outs': self.simulation.timeouts,
                'pushes': self._pushes,
                **figures,
            },
        )
