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
The rotary pendulum once more, merely stated: what its own transcription buys.

The built-in swing-up with ``method: smooth`` is written for this plant, with compiled kernels and
analytic derivatives. Here the same problem is stated like any other: the disk's angle is a
polynomial reference function, the torque follows by inverse dynamics, the pendulum is integrated.
Nothing of it is known to the library; the equations of motion are those of `RotaryPendulum`.

Run it: ``python docs/plants/pendulum.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import time
from typing import ClassVar

import numpy as np
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, Validated
from tdm_planner.plants import PendulumLimits, RotaryPendulum
from tdm_planner.problems import (
    DirectProblem,
    DirectSolverParameters,
    PendulumGoal,
    PendulumStart,
    PendulumSwingUp,
    SolverParameters,
)

STRONG = PendulumLimits(torque=0.09)


@dataclass(frozen=True)
class StatedSwingUp(DirectProblem, Validated):
    """Swing a rotary pendulum up to theta = 0 with a smooth torque in the shortest time."""

    name: ClassVar[str] = 'stated_swing_up'
    state_names, state_units = RotaryPendulum.state_names, RotaryPendulum.state_units
    control_names, control_units = RotaryPendulum.control_names, RotaryPendulum.control_units
    starts: ClassVar[int] = 1  # one is enough, and takes seconds

    plant: RotaryPendulum = group(RotaryPendulum)
    limits: PendulumLimits = STRONG
    start: PendulumStart = group(PendulumStart)
    free: int = parameter(12, "varied parameters of the disk's angle", allowed=NON_NEGATIVE)
    solver: DirectSolverParameters = DirectSolverParameters(deadline=60.0)

    def outputs(self):
        start = self.start.psi, self.start.psi_dot
        return {'psi': Output(start=start, end=(0.0, 0.0), free=self.free, scale=1.0)}

    def integrated(self):
        speed = self.plant.natural_frequency
        return {
            'theta': Integrated(self.start.theta, 0.0),
            'theta_dot': Integrated(self.start.theta_dot, 0.0, scale=speed),
        }

    def duration(self):
        return Duration(guess=5.0 / self.plant.natural_frequency)

    def invert(self, y, z):
        psi, psi_dot, psi_ddot = y['psi']
        states = z['theta'], psi, z['theta_dot'], psi_dot
        torque, _ = self.plant.torque_for(np.stack(states, axis=-1), psi_ddot)
        return states, (torque,)

    def derivative(self, x, u):
        states, torque = np.stack(tuple(x), axis=-1), np.stack(tuple(u), axis=-1)
        return np.moveaxis(self.plant.derivative(states, torque), -1, 0)

    def margins(self, t, x, u):
        return {
            'torque': 1.0 - (u[0] / self.limits.torque) ** 2,
            'disk angle': 1.0 - (x[1] / self.limits.disk_angle) ** 2,
        }

    def final_cost(self, t, x):
        return t


def built_in(start: PendulumStart) -> PendulumSwingUp:
    """Return the same swing-up in the transcription of its own."""
    return PendulumSwingUp(
        limits=STRONG,
        torque_reserve=0.0,
        start=start,
        goal=PendulumGoal(turns=0),
        method='smooth',
        solver=SolverParameters(deadline=3.0),
    )


if __name__ == '__main__':
    print('start [rad]    t_f stated    built in    processor time stated    built in')
    built_in(PendulumStart()).prepare()
    for theta in (math.pi, 2.5):
        start, row = PendulumStart(theta=theta), []
        for problem in (StatedSwingUp(start=start), built_in(start)):
            began = time.process_time()
            row.append((problem.solve().duration, time.process_time() - began))
        (stated, slow), (own, quick) = row
        print(
            f'{theta:11.3f}    {stated:8.4f} s  {own:8.4f} s    {slow:17.2f} s    {quick:6.2f} s'
        )
