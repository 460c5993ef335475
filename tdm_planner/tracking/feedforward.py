# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A plan as a law: its mean control over the coming interval, and the gains of the feedback.

Switches do not fall on the ticks of a tracker; the mean gives the plant the same impulse as the
plan, whereas the value at the tick would shift every switch by up to an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from tdm_planner.tracking.estimator import DifferentiablePlant
from tdm_planner.tracking.linear_quadratic import time_varying_regulator
from tdm_planner.tracking.motion import TrajectoryRejected
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_MOST_GAINS = 12_000  # along a plan; a longer one has them further apart


class Feedforward:
    """Mean of a trajectory's controls over any interval; they are zero outside the trajectory."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._integral = trajectory.control_integral

    def mean(self, start: float, end: float) -> Array:
        """Mean control (nu,) over [start, end], times [s] as in the trajectory, start < end."""
        integral = self._integral([start, end])
        mean: Array = (integral[1] - integral[0]) / (end - start)
        return mean

    def means(self, edges: Array) -> Array:
        """Mean controls (n, nu) between neighbouring `edges` (n + 1,), times that increase."""
        means: Array = np.diff(self._integral(edges), axis=0) / np.diff(edges)[:, None]
        return means


@dataclass(frozen=True, eq=False)
class PlanLaw:
    """
    What is prepared of a plan: feedforward, and gains (n, nu, nx), one every `step` s.

    `costs` (n, nx, nx) are those that a deviation has still to come, as quadratic forms.
    """

    trajectory: Trajectory = field(repr=False)
    feedforward: Feedforward
    gains: Array = field(repr=False)
    costs: Array = field(repr=False)
    step: float

    @classmethod
    def along(
        cls,
        plant: DifferentiablePlant,
        trajectory: Trajectory,
        weights: tuple[Array, Array],
        terminal: Array,
        spacing: float,
    ) -> PlanLaw:
        """
        Return the law of a plan, with gains about every `spacing` s.

        `weights` are Q (nx, nx) and R (nu, nu), `terminal` (nx, nx) weighs the deviation at the
        end. States that the plant has beyond the trajectory's are gains of its model, 1 along the
        plan.

        Raises
        ------
        TrajectoryRejected
            If there is no feedback along the plan.

        """
        nx = len(trajectory.state_names)

        def with_gains(states: Array) -> Array:
            return np.pad(states, ((0, 0), (0, len(plant.state_names) - nx)), constant_values=1.0)

        if trajectory.rates is None:
            trajectory = trajectory.with_rates(
                lambda state, control: plant.derivative(with_gains(state), control)[:, :nx]
            )
        steps = min(max(1, round(trajectory.duration / spacing)), _MOST_GAINS)
        step = trajectory.duration / steps
        sample = trajectory.sample(trajectory.times[0] + step * (np.arange(steps) + 0.5))
        a, b = plant.jacobians(with_gains(sample.state), sample.control)
        try:
            regulator = time_varying_regulator(a, b, *weights, terminal, step)
        except np.linalg.LinAlgError as error:
            raise TrajectoryRejected(
                f'there is no feedback along the trajectory: {error}'
            ) from None
        if not np.isfinite(regulator.gains).all():
            raise TrajectoryRejected('there is no finite feedback along the trajectory')
        costs = regulator.costs_to_go[:-1]
        return cls(trajectory, Feedforward(trajectory), regulator.gains, costs, step)

    def places(self, elapsed: Array) -> NDArray[np.intp]:
        """Places of the gains at instants (n,) [s] after the start; the ends are held."""
        return np.clip(np.round(elapsed / self.step), 0, len(self.gains) - 1).astype(np.intp)

    def gain(self, elapsed: float) -> Array:
        """Gain (nu, nx) at `elapsed` s after the start."""
        return np.asarray(self.gains[self.places(np.asarray(elapsed))])

    def ahead(self, elapsed: float, rates: Array, error: Array) -> float:
        """
        Time [s] by which a state is ahead of the plan, by its deviation `error` (nx,) from it.

        That is how far along the plan, which changes at `rates` (nx,), the deviation is cheapest.
        """
        size = rates.size
        weighed = self.costs[self.places(np.asarray(elapsed)), :size, :size] @ rates
        return float(weighed @ error) / max(float(weighed @ rates), 1e-300)
