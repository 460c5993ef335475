# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Linear-quadratic regulators: at an equilibrium, and along a trajectory.

About a motion x(t), u(t) the deviation obeys dx' = A(t) dx + B(t) du. The feedback du = -K dx that
minimises the integral of dx'Q dx + du'R du, under controls held over steps of h, follows from the
discrete Riccati recursion (Anderson and Moore, "Optimal Control: Linear Quadratic Methods", 1990)

    K_k = (h R + B'P_{k+1} B)^-1 B'P_{k+1} A,   P_k = h Q + A'P_{k+1} (A - B K_k),

with A, B of the step (`discretise`); dx'P_k dx is the cost still to come.

The control of a plan is u(t)'s mean over the command interval: switches do not fall on the ticks
of a tracker, and the mean gives the plant the same impulse as the plan, whereas the value at the
tick would shift every switch by up to an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_discrete_are
from tdm_planner.arrays import Array, exponentials, Integers, Mask
from tdm_planner.tracking.estimator import DifferentiablePlant
from tdm_planner.tracking.motion import Steps, TrajectoryRejected
from tdm_planner.trajectory import Trajectory

_LARGEST_NORM = 1e6  # beyond it the squarings leave few digits
_MOST_GAINS = 12_000  # along a plan; a longer one has them further apart
_GAINS_PER_SECOND = 20_000  # are computed in two fifths of the time


class Regulator(NamedTuple):
    """
    Feedback u = -gain x, gain (nu, nx), with cost to go x' cost_to_go x, (nx, nx).

    Along a trajectory, of every step: (n, nu, nx), and (n+1, nx, nx), the last given.
    """

    gain: Array
    cost_to_go: Array


def discrete_regulator(a: Array, b: Array, q: Array, r: Array, step: float) -> Regulator:
    """
    Regulate x' = a x + b u, u held over steps of `step` s, by step times the sum of the cost.

    States that do not move (`moved`) are left alone. Raise numpy.linalg.LinAlgError if the others
    cannot be stabilised.
    """
    some = moved(a, b)
    if some.any() and not some.all():
        square = np.ix_(some, some)
        found = discrete_regulator(a[square], b[some], q[square], r, step)
        padded = Regulator(np.zeros((b.shape[1], len(a))), np.zeros((len(a), len(a))))
        padded.gain[:, some], padded.cost_to_go[square] = found
        return padded
    a, b = discretise(a, b, step)
    q, r = q * step, r * step
    try:
        cost_to_go = np.asarray(solve_discrete_are(a, b, q, r), dtype=float)
    except (np.linalg.LinAlgError, ValueError) as error:  # where its pencil cannot be ordered
        raise np.linalg.LinAlgError(
            f'the Riccati equation has no stabilising solution: {error}'
        ) from None
    gain = np.linalg.solve(r + b.T @ cost_to_go @ b, b.T @ cost_to_go @ a)
    return Regulator(np.asarray(gain), cost_to_go)


def moved(a: Array, b: Array) -> Mask:
    """Which states (nx,) of x' = a x + b u move; a constant does not, nor energy used, at rest."""
    return np.asarray(np.hstack([a, b]).any(axis=1))


def discretise(a: Array, b: Array, step: float) -> tuple[Array, Array]:
    """
    Transition over `step` s under a held control: exp(a step), and its integral times b.

    (..., nx, nx), (..., nx, nu) -> the same shapes; the exponential of [[a, b], [0, 0]].

    Raise numpy.linalg.LinAlgError if the matrices are not finite, or so large that the exponential
    is not.
    """
    nx, nu = b.shape[-2:]
    # The result is linear in b: in units of its largest entry no large number of it overflows.
    unit = float(np.abs(b).max(initial=0.0)) * step or 1.0
    block = np.zeros((*b.shape[:-2], nx + nu, nx + nu))
    block[..., :nx, :nx] = a * step
    block[..., :nx, nx:] = b * (step / unit)
    largest = float(np.abs(block).sum(axis=-1).max(initial=0.0))
    if not largest < _LARGEST_NORM:
        raise np.linalg.LinAlgError(
            f'no transition over {step:g} s can be computed: the rates are too large'
        )
    with np.errstate(over='ignore', invalid='ignore'):
        exponential = exponentials(block)
    if not np.isfinite(exponential).all():
        raise np.linalg.LinAlgError(f'the transition over {step:g} s is not finite')
    return exponential[..., :nx, :nx], unit * exponential[..., :nx, nx:]


def time_varying_regulator(
    a: Array, b: Array, q: Array, r: Array, terminal: Array, step: float
) -> Regulator:
    """
    Regulate along a trajectory whose deviation obeys dx' = a_k dx + b_k du in step k.

    `a` (n, nx, nx) and `b` (n, nx, nu) are continuous-time Jacobians, one a step of `step` s;
    `terminal` (nx, nx) weighs the deviation at the end.
    """
    transitions, inputs = discretise(a, b, step)
    q, r = q * step, r * step
    n, nx, nu = inputs.shape
    gains = np.empty((n, nu, nx))
    costs_to_go = np.empty((n + 1, nx, nx))
    costs_to_go[n] = cost = terminal
    for k in range(n - 1, -1, -1):
        a_k, b_k = transitions[k], inputs[k]
        weighed = b_k.T @ cost
        gains[k] = np.linalg.solve(r + weighed @ b_k, weighed @ a_k)
        cost = q + a_k.T @ cost @ (a_k - b_k @ gains[k])
        # Rounding must not make the symmetric matrix drift off symmetry.
        costs_to_go[k] = cost = 0.5 * (cost + cost.T)
    return Regulator(gains, costs_to_go)


def mean_controls(trajectory: Trajectory, edges: ArrayLike) -> Array:
    """Mean controls (n, nu) between neighbouring `edges` (n + 1,) [s]; zero outside its times."""
    means: Array = np.diff(trajectory.control_integral(edges), axis=0) / np.diff(edges)[:, None]
    return means


@dataclass(frozen=True, eq=False)
class PlanLaw:
    """
    What is prepared of a plan: gains (n, nu, nx), one every `step` s.

    `costs` (n, nx, nx) are those that a deviation has still to come, as quadratic forms.
    """

    trajectory: Trajectory = field(repr=False)
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
        interval: float,
    ) -> Steps[PlanLaw]:
        """
        Compute the law of a plan, with gains about every `spacing` s, from its end on.

        A step takes about half of `interval` [s].

        `weights` are Q (nx, nx) and R (nu, nu), `terminal` (nx, nx) weighs the deviation at the
        end. States that the plant has beyond the trajectory's are gains of its model, 1 along the
        plan.

        Raise TrajectoryRejected if there is no feedback along the plan.
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
        middles = trajectory.times[0] + step * (np.arange(steps) + 0.5)
        gains = np.empty((steps, len(weights[1]), len(terminal)))
        costs = np.empty((steps, *terminal.shape))
        at_once = math.ceil(_GAINS_PER_SECOND * interval)
        for first in reversed(range(0, steps, at_once)):
            part = slice(first, first + at_once)
            sample = trajectory.sample(middles[part])
            a, b = plant.jacobians(with_gains(sample.state), sample.control)
            try:
                regulator = time_varying_regulator(a, b, *weights, terminal, step)
            except np.linalg.LinAlgError as error:
                raise TrajectoryRejected(
                    f'there is no feedback along the trajectory: {error}'
                ) from None
            gains[part], costs[part] = regulator.gain, regulator.cost_to_go[:-1]
            terminal = costs[first]
            if first > 0:
                yield
        if not np.isfinite(gains).all():
            raise TrajectoryRejected('there is no finite feedback along the trajectory')
        return cls(trajectory, gains, costs, step)

    def places(self, elapsed: Array) -> Integers:
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
