# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tdm_planner.parameters import build
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.tracking.robot_estimation import EstimatedRobot
from tdm_planner.tracking.robot_parameters import RobotTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTracker
from tdm_planner.tracking.tracker import Phase, TrajectoryRefused
from tdm_planner.trajectory import Trajectory
from tdm_sim.mismatch import mismatched, mismatched_gains
from tdm_sim.simulation import PlantSetup, SimulatedPlant

TICK = 0.01
THRUST, RATE, TORQUE = 1.05, 2.0, 0.02
NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005, 0.005, 0.0])


def there_and_stop(distance: float = 1.0, duration: float = 12.0, turn: float = 1.0) -> Trajectory:
    """Accelerate and brake along x by a smooth law, the thruster turned half round in between."""
    robot = FloatingRobot()
    t = np.linspace(0.0, duration, 601)
    s = t / duration
    second = (60 * s - 180 * s**2 + 120 * s**3) / duration**2
    acceleration, spin = distance * second, turn * second
    half = 2.5
    alpha = np.interp(t, [duration / 2 - half / 2, duration / 2 + half / 2], [0.0, math.pi])
    rate = np.gradient(alpha, t)
    yaw = turn * (10 * s**3 - 15 * s**4 + 6 * s**5)
    alpha_body = alpha - yaw
    rate = np.gradient(alpha_body, t)
    push = np.maximum(acceleration * np.cos(alpha), 0.0)
    draft = Trajectory(
        times=t,
        states=np.zeros((t.size, 7)),
        controls=np.stack([robot.mass * push, rate, robot.inertia * spin], axis=1),
        state_names=robot.state_names,
        control_names=robot.control_names,
        interpolation='linear',
    )
    states = robot.replay(draft, t)
    assert states is not None
    object.__setattr__(draft, 'states', states)
    return draft


class Loop:
    """A tracker and a plant stepped together."""

    def __init__(
        self,
        initial: np.ndarray,
        mismatch: float = 0.0,
        noise: float = 0.0,
        seed: int = 0,
        wrap: bool = False,
        **values: Any,
    ) -> None:
        dotted = {name.replace('__', '.'): value for name, value in values.items()}
        self.tracker = RobotTracker(build(RobotTrackerParameters, {'rate': 1 / TICK, **dotted}))
        gains = mismatched_gains(3, mismatch, seed)
        gains[1] = 1.0
        setup = PlantSetup(
            plant=mismatched(self.tracker.parameters.plant, mismatch, seed),
            initial=initial,
            lower=np.array([0.0, -RATE, -TORQUE]),
            upper=np.array([THRUST, RATE, TORQUE]),
            noise=noise * NOISE,
            gains=gains,
            largest_step=0.005,
        )
        self.plant = SimulatedPlant(setup, seed)
        self.wrap = wrap
        self.now = 0.0
        self.states: list[np.ndarray] = []
        self.controls: list[np.ndarray] = []

    def run(self, duration: float) -> None:
        for _ in range(round(duration / TICK)):
            seen = self.plant.measure()
            if self.wrap:
                seen[4] = math.remainder(seen[4], math.tau)
            self.tracker.observe(seen, self.now)
            control = self.tracker.command(self.now).control
            self.plant.command(control)
            self.plant.step(TICK)
            self.states.append(self.plant.state)
            self.controls.append(control)
            self.now += TICK


def distance(loop: Loop, plan: Trajectory) -> float:
    return math.hypot(*(loop.plant.state[:2] - plan.states[-1, :2]))


@pytest.mark.parametrize('seed', range(3))
def test_a_wrong_and_noisy_robot_arrives_and_stays(seed: int) -> None:
    plan = there_and_stop()
    loop = Loop(plan.states[0], mismatch=0.05, noise=1.0, seed=seed)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.2, loop.now)
    start = loop.now
    loop.run(0.1 + plan.duration)
    assert distance(loop, plan) < 0.01
    times = start - 0.2 + TICK * (np.arange(len(loop.states[10:])) + 1)
    offset = np.array(loop.states[10:])[:, :2] - plan.sample(times).state[:, :2]
    assert np.hypot(*offset.T).max() < 0.01
    loop.run(10.0)
    assert loop.tracker.phase is Phase.HOLDING
    late = np.array(loop.states[-500:])
    assert np.hypot(*(late[:, :2] - plan.states[-1, :2]).T).max() < 0.02
    assert np.abs(late[:, 4] - plan.states[-1, 4]).max() < 0.03
    controls = np.array(loop.controls)
    assert controls[:, 0].min() >= 0.0
    assert controls[:, 0].max() <= THRUST
    assert np.abs(controls[:, 1]).max() <= RATE
    assert np.abs(controls[:, 2]).max() <= TORQUE


def test_the_actuator_gains_are_found() -> None:
    plan = there_and_stop()
    loop = Loop(plan.states[0], mismatch=0.2, noise=1.0, seed=2)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.1, loop.now)
    loop.run(plan.duration)
    setup = loop.plant.setup
    assert isinstance(setup.plant, FloatingRobot)
    assert setup.gains is not None
    true_gain = setup.gains[0] * FloatingRobot().mass / setup.plant.mass
    assert abs(true_gain - 1) > 0.05
    assert loop.tracker.estimator.predict(loop.now)[7] == pytest.approx(true_gain, abs=0.02)


def test_the_thruster_turns_before_the_start_and_nothing_is_fired() -> None:
    plan = there_and_stop()
    start = plan.states[0] + np.array([0, 0, 0, 0, 0, 0, 1.5])
    loop = Loop(start)
    loop.run(0.1)
    loop.tracker.accept(plan, 2.0, loop.now)
    loop.run(1.8)
    assert loop.plant.state[6] == pytest.approx(plan.states[0, 6], abs=0.02)
    assert not np.array(loop.controls)[:, [0, 2]].any()


def test_yaw_may_be_wrapped_and_the_thruster_whole_turns_away() -> None:
    plan = there_and_stop(turn=4.0)
    loop = Loop(plan.states[0] + np.array([0, 0, 0, 0, 0, 0, 4 * math.pi]), wrap=True)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.2, loop.now)
    loop.run(plan.duration + 5.0)
    assert distance(loop, plan) < 0.01
    assert abs(math.remainder(loop.plant.state[4] - plan.states[-1, 4], math.tau)) < 0.02
    assert abs(loop.plant.state[6] - plan.states[-1, 6] - 4 * math.pi) < math.pi


def test_the_thruster_keeps_within_reach_of_what_the_plan_needs() -> None:
    plan = there_and_stop()
    tracker = Loop(plan.states[0]).tracker
    law = tracker.prepare(plan)
    lower, upper = law.lower, law.upper
    assert (lower <= upper).all()
    # the edges close in no faster than the thruster can turn
    assert (np.diff(upper) >= -RATE * law.step - 1e-9).all()
    assert (np.diff(lower) <= RATE * law.step + 1e-9).all()
    times = law.step * np.arange(len(lower))
    alpha = plan.sample(times).state[:, 6]
    thrust = plan.sample(times).control[:, 0]
    strong = thrust > 0.5 * thrust.max()
    assert strong.any()
    margin = 0.3 * THRUST / thrust[strong]
    assert (np.abs(np.clip(alpha, lower, upper) - alpha)[strong] < 1e-9).all()
    assert ((upper - alpha)[strong] <= margin + 1e-9).all()


def test_there_is_no_thrust_while_the_direction_is_off() -> None:
    plan = there_and_stop()
    loop = Loop(plan.states[0] + np.array([0, 0, 0, 0, 0, 0, math.pi]))
    loop.tracker.observe(loop.plant.state, 0.0)
    loop.tracker.accept(plan, 0.0, 0.0)
    loop.run(2.0)
    states, controls = np.array(loop.states), np.array(loop.controls)
    heading = np.cos(states[:-1, 4] + states[:-1, 6])
    off = heading < math.cos(1.1)  # the misalignment allowed is 1 rad
    assert off[:50].all()
    assert not controls[1:, 0][off].any()
    assert controls[-1, 0] > 0.0


def test_station_is_kept_against_a_push_without_chatter() -> None:
    plan = there_and_stop(duration=12.0)
    loop = Loop(plan.states[0], noise=1.0)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.2, loop.now)
    loop.run(plan.duration + 3.0)
    quiet = len(loop.controls)
    loop.plant.push(lambda x: x + np.array([0, 0, 0.02, 0.02, 0, 0, 0]))
    loop.run(25.0)
    assert loop.tracker.phase is Phase.HOLDING
    assert distance(loop, plan) < 0.02
    before = quiet - 200
    turning = np.abs(np.array(loop.controls)[before:quiet, 1])
    assert np.mean(turning > 0.1) < 0.4
    assert np.mean(np.array(loop.controls)[-300:, 0] > 0) < 0.3


def test_a_robot_carried_away_is_given_up() -> None:
    plan = there_and_stop()
    loop = Loop(plan.states[0])
    loop.run(0.1)
    loop.tracker.accept(plan, 0.2, loop.now)
    loop.run(3.0)
    loop.plant.push(lambda x: x + np.array([0.5, 0, 0, 0, 0, 0, 0]))
    loop.run(0.1)
    assert loop.tracker.phase is Phase.STOPPED
    assert not loop.controls[-1].any()
    with pytest.raises(TrajectoryRefused, match=r'tolerance\.start'):
        loop.tracker.accept(plan, loop.now + 1.0, loop.now)


def test_where_a_new_plan_is_wanted_the_robot_brakes() -> None:
    plan = there_and_stop()
    loop = Loop(plan.states[0], noise=1.0, replan__on_deviation=True)
    loop.run(0.1)
    loop.tracker.accept(plan, 0.2, loop.now)
    loop.run(3.0)
    loop.plant.push(lambda x: x + np.array([0.1, 0.4, 0.1, 0.1, 0, 0.3, 0]))
    loop.run(0.05)
    assert loop.tracker.phase is Phase.RECOVERING
    assert not loop.tracker.wants_plan
    loop.run(8.0)
    assert loop.tracker.wants_plan
    assert np.hypot(*loop.plant.state[2:4]) < 0.015
    assert not loop.controls[-1].any()


def test_jacobians_agree_with_finite_differences() -> None:
    plant = EstimatedRobot(FloatingRobot())
    rng = np.random.default_rng(0)
    for _ in range(5):
        state, control = rng.normal(size=9), rng.normal(size=3)
        by_state, by_control = plant.jacobians(state, control)
        for column in range(9):
            step = 1e-6 * np.eye(9)[column]
            difference = plant.derivative(state + step, control) - plant.derivative(
                state - step, control
            )
            assert np.allclose(by_state[:, column], difference / 2e-6, atol=1e-6)
        for column in range(3):
            step = 1e-6 * np.eye(3)[column]
            difference = plant.derivative(state, control + step) - plant.derivative(
                state, control - step
            )
            assert np.allclose(by_control[:, column], difference / 2e-6, atol=1e-6)
