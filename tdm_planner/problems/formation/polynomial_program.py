# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The program of robots whose motions are polynomials of the virtual arc."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Multipliers
from tdm_planner.problems.formation.approaches import CLOSENESS
from tdm_planner.problems.formation.polynomial_kernels import (
    ACTIVE_THRUST,
    derivatives,
    evaluate,
    grid_of,
    Manoeuvre,
    Values,
)
from tdm_planner.problems.formation.program import FormationProgram
from tdm_planner.problems.formation.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.formation.task import first_arrival, FormationTask, least_time

Array = NDArray[np.float64]

_USED = 0.67  # of F_max, assumed by an initial guess: polynomials seldom give more


class PolynomialProgram(FormationProgram):
    """
    The program of one manoeuvre by the reference motions of `model`.

    Staying robots have only their times (and attitudes) varied. `held` (n, P) holds the
    parameters of robots whose motion is not varied but avoided by the others, NaN for those of
    the others.
    """

    curvature = 1e-6, 1e-3

    def __init__(self, model: ReferenceMotion, held: Array | None = None) -> None:
        self.model, task, nb = model, model.task, model.nb
        self.held = np.full((task.n, model.size), np.nan) if held is None else held
        turn = least_time(task.goal_yaw - task.departure_yaw, task.yaw_rate, task.torque)
        number = np.arange(model.size)
        super().__init__(
            task,
            first_arrival(task, turn, _USED * task.thrust),
            np.tile(model.units, (task.n, 1)),
            np.where(number < nb, 1.0 / nb, 0.0),
            (number < nb) | (number >= model.size - model.ny),
            ~np.isnan(self.held[:, 0]),
        )
        self._set_bounds()
        walls, (centres, _) = task.wall_clearances(), task.circles()
        self.manoeuvre = Manoeuvre(
            grid=grid_of(model.form),
            motion=model.tables,
            coast=np.ascontiguousarray(task.coast),
            thrust=float(task.thrust),
            torque=float(task.torque),
            low=np.ascontiguousarray(walls[..., 0]),
            high=np.ascontiguousarray(task.sides - walls[..., 1]),
            separation=float(task.separation),
            clearances=self.clearances,
            centres=np.ascontiguousarray(centres),
            interval=self.interval,
            kept=self.kept,
            varied=self.varied,
        )

    def _set_bounds(self) -> None:
        task, model, nb = self.task, self.model, self.model.nb
        lower, upper = (np.full(self.units.shape, sign * np.inf) for sign in (-1.0, 1.0))
        # The speed factor's coefficients must stay positive, and well so.
        lower[:, :nb] = (0.05 if nb == 1 else 0.4) * model.time
        lower[task.staying, :nb] = 0.02 * model.time
        upper[:, :nb] = np.maximum(task.longest - task.coast, 0.1)[:, None]
        upper[task.staying & (task.arrived > 0.0), :nb] = 0.03 * model.time  # there already
        lower = np.minimum(lower, 0.9 * upper)
        self.bound(lower, upper, np.nan_to_num(self.held))

    def motion(self, xi: Array) -> FormationMotion:
        """Return the motions at Xi."""
        return self.model.unpack(self.full(xi))

    def fly(self, x: Array, found: Array) -> tuple[Values, float, float]:
        """Return gas and margins, all gas, and the worst margin."""
        values = evaluate(self.manoeuvre, x, found)
        margins = values.thrust, values.torque, values.walls, values.approaches[:, CLOSENESS]
        worst = min(float(margin.min(initial=1.0)) for margin in margins)
        return values, float(values.gas.sum()), worst

    def derive(
        self, flown: Values, multipliers: Multipliers | None
    ) -> tuple[Array, Array, Array, Array, tuple[NDArray[np.intp], ...]]:
        """Differentiate gas and margins; second derivatives are those of gas and thrust rows."""
        dual = np.zeros(flown.thrust.shape)
        if multipliers is not None:
            robots, nodes = multipliers.tags
            dual[robots, nodes] = multipliers.inequalities[: robots.size]
        found = derivatives(self.manoeuvre, flown, self.weights[2], dual)
        return *found, np.nonzero(flown.thrust < ACTIVE_THRUST)

    def own_margins(self, flown: Values) -> dict[str, Array]:
        """Margins of thrust, torque and walls."""
        return {
            "limits.thrust of '{}'": flown.thrust,
            "limits.torque of '{}'": flown.torque,
            "the distance of '{}' from the walls": flown.walls,
        }


def compile_polynomials(task: FormationTask) -> None:
    """Compile the kernels or load them from the disk."""
    program = PolynomialProgram(ReferenceMotion(task))
    x = np.tile(program.model.units, (task.n, 1))
    program.linearise(program.evaluate(program.reduce(x)), None)
