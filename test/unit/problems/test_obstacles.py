# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Obstacles: motions that leap over them between two nodes, and the ways round."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from stated import changed, noted, Quickest
from tdm_planner.direct_method import Budget, Output
from tdm_planner.problems.direct.guesses import Guesses
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.refinement import Refinement


def beside_the_disc(self, t, x, u):
    """Keep tip, elbow and the middles of both links out of a disc."""
    right, up = self.away * np.cos(self.angle), self.away * np.sin(self.angle)
    left = {'elbow': 2.8 - x[1], 'elbow back': 2.8 + x[1]}
    for share in (0.5, 1.0):
        first = [share * along(x[0]) for along in (np.cos, np.sin)]
        second = [along(x[0]) + share * along(x[0] + x[1]) for along in (np.cos, np.sin)]
        for name, (x_, y_) in {'first': first, 'second': second}.items():
            left[f'{name} link at {share:g}'] = (x_ - right) ** 2 + (y_ - up) ** 2 - self.radius**2
    return left


def from_to(first, last):
    return Output(start=(first, 0.0), end=(last, 0.0), free=5)


# Two coordinates and their rates, accelerated by the controls.
ACCELERATED = {
    'invert': lambda s, y, z: (
        tuple(jet[order] for order in (0, 1) for jet in y.values()),
        tuple(jet[2] for jet in y.values()),
    ),
    'derivative': lambda s, x, u: (*x[2:], *u),
}


ARM = changed(
    Quickest,
    __doc__='Two links of 1 m that turn by 2 rad, past a disc; their joints accelerate.',
    states={'q1': 'rad', 'q2': 'rad', 'w1': 'rad/s', 'w2': 'rad/s'},
    controls={'a1': 'rad/s^2', 'a2': 'rad/s^2'},
    outputs=lambda s: {'q1': from_to(0.0, 2.0), 'q2': from_to(0.3, 0.3)},
    control_limits=lambda s: {'a1': (-3.0, 3.0), 'a2': (-4.0, 4.0)},
    margins=beside_the_disc,
    **ACCELERATED,
    **{'angle': 1.73, 'away': 1.63, 'radius': 0.3},  # [rad], [m]
)
DISCS = (
    (3.987, -1.061, 0.859),
    (3.910, 1.149, 0.958),
    (1.977, 1.556, 0.741),
    (4.274, 0.102, 0.502),
    (4.172, -0.701, 0.557),
)
FIELD = changed(
    Quickest,
    __doc__='A mass between discs that leave no gap.',
    states={'x': 'm', 'y': 'm', 'vx': 'm/s', 'vy': 'm/s'},
    controls={'ax': 'm/s^2', 'ay': 'm/s^2'},
    outputs=lambda s: {'x': from_to(0.0, 10.0), 'y': from_to(0.0, 0.0)},
    control_limits=lambda s: {'ax': (-1.0, 1.0), 'ay': (-1.0, 1.0)},
    margins=lambda s, t, x, u: {
        **{f'{a} m': (x[0] - a) ** 2 + (x[1] - b) ** 2 - r**2 for a, b, r in DISCS},
        'speed': 4.0 - x[2] ** 2 - x[3] ** 2,
    },
    guess=8.0,
    **ACCELERATED,
)


@pytest.mark.parametrize(('angle', 'away', 'best'), [(1.73, 1.63, 2.37), (1.06, 1.78, 2.19)])
def test_an_arm_whose_first_motions_leap_over_a_disc_is_planned_for(angle, away, best):
    """Its tip moves farther than the disc is wide from one node to the next."""
    assert changed(ARM, angle=angle, away=away)().solve(3.0, counted=True).cost < best


def test_a_motion_that_cuts_a_corner_does_not_leap():
    """A reserve moves it out, though the next solution may cut in a little deeper."""
    assert FIELD().solve(3.0, counted=True).cost < 7.1


def test_of_bent_lines_one_is_taken_that_leads_round_an_obstacle():
    plant = DirectPlant(ARM())
    ends = Refinement(plant, Budget(60.0)).ends
    blocked = {False: 0, True: 0}  # by whether they are screened
    for seed, screen in itertools.product(range(5), blocked):
        guesses = Guesses(plant, ends, Budget(60.0), seed)
        for line in (guesses.line(straight=False, screen=screen) for _ in range(2)):
            left = plant.limits(*line.halves)[:, plant.obstacles]
            blocked[screen] += bool((left < 0.0).any())
    assert blocked[True] == 0 < blocked[False]


def test_solutions_that_are_one_are_taken_further_once(monkeypatch):
    """Whose J on as many intervals is the same."""
    tried = noted(monkeypatch, Refinement, 'finer')
    changed(ARM, angle=1.4, away=1.6)().solve(3.0, counted=True)
    begun = [round(call.args[1].cost, 4) for call in tried.call_args_list]
    assert len(begun) == len(set(begun))
