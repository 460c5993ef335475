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
The swing-up by Drake: MultibodyPlant and DirectCollocation, solved by SNOPT or Ipopt.

Drake's equations of motion are its own, made from bodies and joints; its units of torque and time
are chosen such that all variables are of order one.
"""

from __future__ import annotations

from dataclasses import dataclass
import time
from typing import Any

from benchmark.peers.pendulum_collocation import linear_motion
from benchmark.peers.pendulum_guesses import Guess
import numpy as np
from numpy.typing import NDArray
from pydrake.all import (
    DirectCollocation,
    FixedOffsetFrame,
    IpoptSolver,
    MultibodyPlant,
    PiecewisePolynomial,
    RevoluteJoint,
    RigidTransform,
    RotationalInertia,
    SnoptSolver,
    SolverOptions,
    SpatialInertia,
    UnitInertia,
)
from tdm_planner.plants import RotaryPendulum
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_ORDER = [1, 0, 3, 2]  # Drake's psi, theta, psi', theta' in the order of this package, and back
SOLVERS = {'SNOPT': SnoptSolver, 'Ipopt': IpoptSolver}


@dataclass(frozen=True)
class Found:
    """What the solver returned, its processor time [s], and the motion."""

    converged: bool
    seconds: float
    motion: Trajectory


def multibody(plant: RotaryPendulum, torque: float = 1.0, frequency: float = 1.0) -> Any:
    """Return the rig with torques in units of `torque` [N m] and time in 1/`frequency` [s]."""
    # Torque is mass length^2 / time^2: with metres kept, this is the unit of mass.
    unit = torque / frequency**2
    inertia = plant.inertia
    model = MultibodyPlant(0.0)
    disk = model.AddRigidBody(
        'disk',
        SpatialInertia(1.0, [0.0, 0.0, 0.0], UnitInertia(*[inertia.disk / unit] * 3)),
    )
    # At upright: x along the pivot's axis, z along the rod.
    moments = np.array([inertia.z, inertia.x, inertia.y]) / unit
    pendulum = model.AddRigidBody(
        'pendulum',
        SpatialInertia.MakeFromCentralInertia(
            plant.mass / unit, [0.0, 0.0, plant.com_distance], RotationalInertia(*moments)
        ),
    )
    axis = [0.0, 0.0, 1.0]
    psi = model.AddJoint(RevoluteJoint('psi', model.world_frame(), disk.body_frame(), axis))
    offset = RigidTransform([plant.arm_length, 0.0, 0.0])
    pivot = model.AddFrame(FixedOffsetFrame('pivot', disk.body_frame(), offset))
    model.AddJoint(RevoluteJoint('theta', pivot, pendulum.body_frame(), [-1.0, 0.0, 0.0]))
    model.AddJointActuator('motor', psi)
    gravity = plant.gravity / frequency**2
    model.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
    model.Finalize()
    return model


class DrakeSwingUp:
    """Minimum-time swing-ups with one torque limit on `intervals` equal intervals."""

    def __init__(self, task: SwingUpTask, intervals: int, solver: str = 'SNOPT') -> None:
        began = time.process_time()
        self.task, self.intervals = task, intervals
        self.frequency = task.plant.natural_frequency
        self.unit = np.array([1.0, 1.0, self.frequency, self.frequency])
        model = multibody(task.plant, task.torque, self.frequency)
        self._collocation = DirectCollocation(
            model,
            model.CreateDefaultContext(),
            num_time_samples=intervals + 1,
            minimum_time_step=1e-3,
            maximum_time_step=100.0 / intervals,
            input_port_index=model.get_actuation_input_port().get_index(),
        )
        program = self._program = self._collocation.prog()
        self._collocation.AddEqualTimeIntervalsConstraints()
        for k in range(intervals + 1):
            program.AddBoundingBoxConstraint(-1.0, 1.0, self._collocation.input(k))
            angle = self._collocation.state(k)[0]
            program.AddBoundingBoxConstraint(-task.disk_angle, task.disk_angle, angle)
        zero = np.zeros(4)
        self._ends = [
            program.AddBoundingBoxConstraint(zero, zero, state).evaluator()
            for state in (self._collocation.initial_state(), self._collocation.final_state())
        ]
        self._collocation.AddFinalCost(self._collocation.time())
        self._solver = SOLVERS[solver]()
        self._options = SolverOptions()
        snopt = SnoptSolver.id()
        self._options.SetOption(snopt, 'Major iterations limit', 1000)
        self._options.SetOption(snopt, 'Iterations limit', 100000)
        self._options.SetOption(IpoptSolver.id(), 'max_iter', 1000)
        self.variables = program.num_vars()
        self.build_seconds = time.process_time() - began

    def solve(self, start: Array, goal: Array, guess: Guess) -> Found:
        """Solve from a guess."""
        for evaluator, state in zip(self._ends, (start, goal), strict=True):
            values = (state / self.unit)[_ORDER]
            evaluator.set_bounds(values, values)
        nodes = np.linspace(0.0, guess.duration, self.intervals + 1)
        states, torques = guess.at(nodes)
        scaled = nodes * self.frequency
        self._collocation.SetInitialTrajectory(
            PiecewisePolynomial.FirstOrderHold(
                scaled, np.clip(torques / self.task.torque, -0.9, 0.9)[None]
            ),
            PiecewisePolynomial.FirstOrderHold(scaled, (states / self.unit)[:, _ORDER].T),
        )
        began = time.process_time()
        result = self._solver.Solve(self._program, None, self._options)
        seconds = time.process_time() - began
        collocation = self._collocation
        times = collocation.GetSampleTimes(result) / self.frequency
        torques = np.clip(collocation.GetInputSamples(result)[0], -1.0, 1.0) * self.task.torque
        states = collocation.GetStateSamples(result).T[:, _ORDER] * self.unit
        motion = linear_motion(self.task.plant, float(times[-1]), states, torques)
        return Found(bool(result.is_success()), seconds, motion)
