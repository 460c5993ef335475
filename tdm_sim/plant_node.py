# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The node of every simulated plant, and what it asks of a plant: its parameters, drawing, pushes.

Every event (timer, command, service) integrates the plant up to the present. Late timers so delay
messages and do not change the speed of the motion; what exceeds `LONGEST_CATCH_UP` is skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.time import Time
from rclpy.time_source import CLOCK_TOPIC
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.arrays import Array
from tdm_planner.drawing import Drawn
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.clocks import MotionClock, pacing_clock, RateWatch
from tdm_planner.nodes.diagnostics import Diagnostics, PublisherCount, Report
from tdm_planner.nodes.markers import MARKER_DEPTH, MARKER_RATE, Picture
from tdm_planner.nodes.messages import joint_states, LATCHED, NEWEST, odometry, QUEUE
from tdm_planner.nodes.reading import Level, read_command
from tdm_planner.nodes.ros_parameters import ParameterNode, WARNING_PERIOD
from tdm_planner.nodes.runtime import check_topic
from tdm_planner.parameters import (
    build,
    NON_NEGATIVE,
    parameter,
    ParameterSpec,
    positive,
    Range,
    SEED,
    specifications,
    Validated,
)
from tdm_planner.plant_kind import PlantKind
from tdm_sim.clock_source import ClockSource
from tdm_sim.simulation import PlantSetup, SimulatedPlant
from visualization_msgs.msg import MarkerArray

LONGEST_CATCH_UP = 0.1  # s that a stalled process integrates at once; it skips the rest
_COUNTED = ('states published', 'commands accepted', 'commands ignored', 'pushes')


@dataclass(frozen=True)
class SimulationParameters(Validated):
    """Parameters of every simulated plant; subclasses add the plant's own."""

    rate: float = parameter(
        200.0, 'rate of the published states', unit='Hz', allowed=Range(0.1, 1e3), read_only=True
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
    command_timeout: float = positive(
        0.1, 'simulated time without a command after which the actuators are switched off', 's'
    )
    mismatch: float = parameter(
        0.0,
        'largest relative error put on every physical constant, at random (0.05 is 5 %)',
        allowed=Range(0.0, 1.0, upper_open=True),
    )
    mismatch_seed: int = parameter(
        0, 'seed of the mismatch: the same seed gives the same plant', allowed=SEED
    )
    seed: int = parameter(
        0,
        'seed of measurement noise and push directions',
        allowed=SEED,
        read_only=True,
    )


def deviation(of: str, unit: str) -> Any:
    """Declare the standard deviation of a measurement (white, Gaussian noise)."""
    return parameter(
        0.0, f'standard deviation of the noise of {of}', unit=unit, allowed=NON_NEGATIVE
    )


@dataclass(frozen=True)
class PlantModel:
    """
    A plant to be simulated: its joints, parameters and functions of them.

    The joints may have states that the simulation alone knows (the angle of a wheel). `push` gives
    one push of `disturbance.impulse` and returns a description. `name`, of parameters and
    namespace, is that of one of several plants. `description` is the URDF, '' if there is none.
    """

    parameters: type[SimulationParameters]
    kind: PlantKind
    setup: Callable[[Any], PlantSetup]  # without what is common to all plants
    push: Callable[[Any, SimulatedPlant, str], str]  # parameters, plant, its name
    drawn: Callable[[Any], Drawn]
    name: Callable[[Any, str], str] = lambda *_: ''
    description: Callable[[Any], str] = lambda _: ''


class PlantNode(ParameterNode):
    """
    A simulated plant in real time; `make_model` says which, once the `first` parameters are known.

    Subscribes `joint_command`, publishes `joint_states`, `odom` and `robot_description` where the
    plant has them, `plant_markers` and `/diagnostics`, serves `reset` and `push`. Changed
    parameters act at once, without a jump of the state (`initial.*` at `reset`); those that
    contradict each other at the start raise InvalidProblem.
    """

    def __init__(
        self,
        name: str,
        make_model: Callable[[PlantNode], PlantModel],
        first: Mapping[str, ParameterSpec] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name, first, **options)
        self.model = make_model(self)
        self.declare(specifications(self.model.parameters))
        self.warn_of_unknown_overrides()
        self.parameters: Any = build(self.model.parameters, self.parameter_values)
        given: Any = self.parameters
        kind = self.model.kind
        self.simulation = SimulatedPlant(self._setup(given), given.seed)
        self._joints = [joint for joint in kind.joints if joint.name not in kind.odometry]
        self._tells_rates = any(joint.position and not joint.velocity for joint in self._joints)
        diagnostics = Diagnostics(self, 'simulation', self._report)
        harm = 'the plant follows the newest of their commands; run only one of them'
        self._counted = [PublisherCount(self, 'joint_command', harm, diagnostics.update, 'nodes')]
        self._clock_source = None
        for topic in given.clock_followers:
            check_topic(topic, "parameter 'clock_followers'")
        if given.publish_clock:
            speed = given.real_time_factor
            self._clock_source = ClockSource(self, 1.0 / given.rate, speed, given.clock_followers)
            harm = 'simulated time leaps; let only one of them publish it'
            clocks = PublisherCount(self, CLOCK_TOPIC, harm, diagnostics.update, 'nodes')
            self._counted.append(clocks)
        self._time = MotionClock(self)
        self._last = self._time.now()
        self._skipped = 0.0
        self._counts = dict.fromkeys(_COUNTED, 0)
        self._warned_timeouts = self._warned_breakdowns = 0
        self._drawn = 0  # instant [ns]
        self._name = self.model.name(given, self.get_namespace())
        warn = self.get_logger().warning
        self._picture = Picture(self.model.drawn(given), self._name, warn)
        self._markers = self.create_publisher(MarkerArray, 'plant_markers', MARKER_DEPTH)
        self._joint_states = self.create_publisher(JointState, 'joint_states', QUEUE)
        self._odometry = self.create_publisher(Odometry, 'odom', QUEUE) if kind.odometry else None
        self._described = ''
        self._description: Any = None
        self._describe()
        self.create_subscription(JointState, 'joint_command', self._on_command, NEWEST)
        self.create_service(Trigger, 'reset', self._on_reset)
        self.create_service(Trigger, 'push', self._on_push)
        self._timer = self._make_timer()

    def _setup(self, given: Any) -> PlantSetup:
        return replace(self.model.setup(given), command_timeout=given.command_timeout)

    def _make_timer(self) -> Timer:
        period = 1.0 / self.parameters.rate
        clock = pacing_clock(self)
        if self._clock_source is not None:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            period /= self._clock_source.speed
        self._rate = RateWatch(1.0 / period, clock)
        return self.create_timer(period, self._on_timer, clock=clock)

    def check_values(self, values: Mapping[str, Any]) -> None:
        """Reject values that contradict each other."""
        self._setup(build(self.model.parameters, values))

    def values_changed(self) -> None:
        """Apply changed parameters."""
        self.advance()
        given: Any = build(self.model.parameters, self.parameter_values)
        self.parameters = given
        self.simulation.setup = self._setup(given)
        self._picture.set_up(self.model.drawn(given))
        self._describe()
        source, speed = self._clock_source, given.real_time_factor
        if source is not None and source.speed != speed:
            source.advance()
            source.speed = speed
            self.destroy_timer(self._timer)
            self._timer = self._make_timer()

    def _describe(self) -> None:
        """Let the URDF follow the parameters, which have no mismatch."""
        description = self.model.description(self.parameters)
        if description != self._described:
            if self._description is None:
                self._description = self.create_publisher(String, 'robot_description', LATCHED)
            self._described = description
            self._description.publish(String(data=description))

    def advance(self) -> Time:
        """Integrate up to the present and return its stamp."""
        now = self._time.now()
        stamp: Time = self.get_clock().now()
        elapsed, self._last = now - self._last, now
        self._skipped += max(elapsed - LONGEST_CATCH_UP, 0.0)
        if elapsed > 0.0:
            # With a clock of its own the motion runs as fast as that clock.
            factor = 1.0 if self._clock_source else self.parameters.real_time_factor
            self.simulation.step(factor * min(elapsed, LONGEST_CATCH_UP))
        return stamp

    def _on_timer(self) -> None:
        self._rate.tick()
        if self._clock_source is not None:
            self._clock_source.advance()
        now = self.advance()
        measured = self.simulation.measure()
        self._publish(measured, now)
        self._counts['states published'] += 1
        self._show(measured, now)
        if self.simulation.timeouts > self._warned_timeouts:
            self._warned_timeouts = self.simulation.timeouts
            timeout = self.parameters.command_timeout
            told = f'no command for {timeout:g} s (command_timeout): actuators off'
            self.get_logger().warning(told, throttle_duration_sec=WARNING_PERIOD)
        if self.simulation.breakdowns > self._warned_breakdowns:
            self._warned_breakdowns = self.simulation.breakdowns
            told = 'the motion could not be integrated: back in the initial state'
            self.get_logger().error(told, throttle_duration_sec=WARNING_PERIOD)

    def _publish(self, measured: Array, now: Time) -> None:
        """Publish the state (nx,) as measured, and the controls as applied."""
        plant, stamp = self.simulation.setup.plant, now.to_msg()
        values = dict(zip(plant.state_names, measured.tolist(), strict=True))
        applied = dict(zip(plant.control_names, self.simulation.control.tolist(), strict=True))
        rates = dict[str, float]()
        if self._tells_rates:
            found = self.simulation.rates(measured).tolist()
            rates = dict(zip(plant.state_names, found, strict=True))
        message = joint_states(self._joints, values | applied, rates)
        message.header.stamp, message.header.frame_id = stamp, self._name
        self._joint_states.publish(message)
        if self._odometry is not None:
            noise = self.simulation.setup.noise.tolist()
            deviations, kind = dict(zip(plant.state_names, noise, strict=True)), self.model.kind
            self._odometry.publish(odometry(kind, values, deviations, stamp, self._name))

    def _show(self, measured: Array, now: Time) -> None:
        self._picture.add(self._last, measured)
        elapsed = now.nanoseconds - self._drawn
        if 0 <= elapsed * MARKER_RATE < 1e9 or not self._markers.get_subscription_count():
            return
        self._drawn = now.nanoseconds
        shown = self._picture.draw(now.to_msg(), measured, self.simulation.control)
        if shown.markers:
            self._markers.publish(shown)

    def _on_command(self, message: JointState) -> None:
        self.advance()
        try:
            self.simulation.command(read_command(self.model.kind, message))
        except InvalidProblem as error:
            self._counts['commands ignored'] += 1
            told = f'joint_command ignored: {error}'
            self.get_logger().warning(told, throttle_duration_sec=WARNING_PERIOD)
            return
        self._counts['commands accepted'] += 1

    def _on_reset(self, *_: Any) -> Trigger.Response:
        self.advance()
        self.simulation.reset()
        self._picture.clear()
        return Trigger.Response(success=True, message='back in the initial state')

    def _on_push(self, *_: Any) -> Trigger.Response:
        self.advance()
        description = self.model.push(self.parameters, self.simulation, self._name)
        self._counts['pushes'] += 1
        self.get_logger().info(description)
        return Trigger.Response(success=True, message=description)

    def _report(self) -> Report:
        simulation, slow = self.simulation, self._rate.problem()
        lost = f'reset {simulation.breakdowns} times: the motion could not be integrated'
        errors = [lost] if simulation.breakdowns else []
        warnings = [self._time.problem, *(count.warning for count in self._counted)]
        if self._skipped > 0.0:
            leapt = ', or /clock leapt' if self.get_clock().ros_time_is_active else ''
            warnings.append(f'{self._skipped:.3g} s skipped: the process was stalled{leapt}')
        warnings.append(slow and f'states at {slow}')
        told = '; '.join(filter(None, [*errors, *warnings]))
        level = Level.ERROR if errors else Level.WARN if told else Level.OK
        figures = {
            'simulated time [s]': simulation.time,
            'time skipped [s]': self._skipped,
            'rate [Hz]': self._rate.measured(),
            **self._counts,
            'command time-outs': simulation.timeouts,
            **({'held': simulation.held} if simulation.setup.held else {}),
        }
        return Report(level, told or ('driven' if simulation.commanded else 'no command'), figures)
