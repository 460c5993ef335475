# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Limits on one state or control bound it while Ipopt searches: rates may have poles beyond."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from tdm_planner.direct_method import Duration, Integrated, Output
from tdm_planner.direct_method.graphs import SimpleBounds
from tdm_planner.problems import DirectProblem


def test_limits_that_are_linear_in_one_variable_bound_it() -> None:
    t, x, u, p = ca.SX.sym('t'), ca.SX.sym('x', 2), ca.SX.sym('u'), ca.SX.sym('p', 2)
    rows = [
        2.0 * x[0] - 1.0,  # at least
        p[0] - x[1] / 4.0,  # at most
        3.0 - x[1],  # at most: the tighter one
        x[0] + x[1],  # on two states
        p[0] - u,
        u - t,  # depends on time
        1.0 - x[0] ** 2,
        p[1] * x[0] + 5.0,  # on none where that number is 0
        1.0 - x[0] + ca.floor(x[0]),  # jumps
        2.0 - ca.floor(p[0]) * u,
    ]
    single = SimpleBounds(ca.Function('limits', [t, x, u, p], [ca.vertcat(*rows)]))
    assert np.flatnonzero(single.bound).tolist() == [0, 1, 2, 4, 7, 9]
    kept = np.zeros((2, len(rows)))
    kept[1, :2] = 0.2
    low, high = single.bounds(np.array([1.0, 0.0]), kept)
    assert low == pytest.approx(np.array([[0.5, -np.inf, -np.inf], [0.6, -np.inf, -np.inf]]))
    assert high == pytest.approx(np.array([[np.inf, 3.0, 1.0], [np.inf, 3.0, 1.0]]))
    high = single.bounds(np.array([0.5, -1.0]), kept)[1].ravel()
    assert high == pytest.approx([5.0, 2.0, 0.5, 5.0, 1.2, 0.5])


@dataclass(frozen=True)
class Penicillin(DirectProblem):
    """Most product of a fed batch; below no sugar growth and consumption have poles."""

    name = 'penicillin'
    state_names, state_units = ('biomass', 'sugar', 'product', 'volume'), ('g/l',) * 4
    control_names, control_units = ('feed',), ('g/h',)

    def outputs(self):
        return {'volume': Output(start=(7.0,), free=8, derivatives=1, scale=3.0)}

    def integrated(self):
        starts = {'biomass': 1.5, 'sugar': 0.0, 'product': 0.0}
        return {name: Integrated(start, scale=10.0) for name, start in starts.items()}

    def duration(self):
        return Duration(guess=126.0, fixed=True)

    def invert(self, y, z):
        volume, rate = y['volume']
        return (z['biomass'], z['sugar'], z['product'], volume), (500.0 * rate,)

    def derivative(self, x, u):
        biomass, sugar, product, volume = x
        growth = 0.11 * sugar / (0.006 * biomass + sugar)
        making = 0.0055 * sugar / (0.02 + sugar * (1.0 + 10.0 * sugar))
        thinner = u[0] / 500.0 / volume
        eaten = (growth / 0.47 + making / 1.2 + 0.029 * sugar / (0.02 + sugar)) * biomass
        fed = u[0] / volume - eaten - thinner * sugar
        made = making * biomass - (0.01 + thinner) * product
        return (growth - thinner) * biomass, fed, made, u[0] / 500.0

    def margins(self, t, x, u):
        return {'thick': 1.0 - x[0] / 40.0, 'sugar': x[1] / 10.0, 'full': 12.0 - x[3]}

    def control_limits(self):
        return {'feed': (0.0, 30.0)}

    def final_cost(self, t, x):
        return -x[2] * x[3]


def test_a_search_does_not_leave_the_range_in_which_rates_are_finite() -> None:
    """Cuthrell and Biegler 1989, the model; the best known is 41.5455 g, from many guesses."""
    assert Penicillin().solve(counted=True).cost == pytest.approx(-41.5455, rel=1e-3)
