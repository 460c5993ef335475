# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""No plan that violates a limit leaves a sabotaged solver: 60 here, 1000 with TDM_FUZZ=nightly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import json
import math
import os
from typing import Any

import numpy as np
import pytest
from replays import faults
import saboteurs
from saboteurs import blind_verification, nothing, SABOTEURS
from tdm_planner.exceptions import Infeasible, InvalidProblem
from tdm_planner.plan_files import plan_document
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.base import Problem

NIGHTLY = os.environ.get('TDM_FUZZ') == 'nightly'
WANTED = {'pendulum': 600 if NIGHTLY else 36, 'robots': 400 if NIGHTLY else 24}
UNCHECKED = 300 if NIGHTLY else 30
BITES = 0.05  # least share that violates, unchecked: 43 of 150 pendulums did, 31 of 96 robots
SMALLEST, LARGEST = 1e-8, 0.3  # sizes of sabotage


def pendulum(rng: np.random.Generator) -> Problem:
    """Any start, motors weak and strong, narrow and wide limits, every method."""
    angle = rng.uniform(0.6, 3.0)
    return PendulumSwingUp.from_parameters(
        {
            'limits.torque': float(np.exp(rng.uniform(math.log(0.015), math.log(0.3)))),
            'limits.disk_angle': angle,
            'torque_reserve': float(rng.choice([0.0, 0.3])),
            'start.theta': rng.uniform(-7.0, 7.0),
            'start.psi': rng.uniform(-0.5, 0.5) * angle,
            'start.theta_dot': rng.normal() * 2.0,
            'start.psi_dot': rng.normal(),
            'method': str(
                rng.choice(['switching', 'switching', 'switching', 'smooth', 'virtual_arc'])
            ),
            'goal.turns': None if rng.uniform() < 0.8 else int(rng.integers(-1, 2)),
            'solver.deadline': 0.15,
        }
    )


def robots(rng: np.random.Generator) -> Problem:
    """One to three robots, at rest or not, sluggish and brisk, with and without zones."""
    count = int(rng.integers(1, 4))
    values: dict[str, Any] = {
        'robots': [f'robot{k + 1}' for k in range(count)],
        'formation.anchor': [2.0, 2.0, rng.uniform(-3.0, 3.0)],
        'limits.thrust': float(np.exp(rng.uniform(math.log(0.3), math.log(30.0)))),
        'limits.thruster_rate': float(np.exp(rng.uniform(math.log(0.5), math.log(10.0)))),
        'arena.tracking_margin': float(rng.choice([0.0, 0.03])),
        'weights.gas': float(rng.choice([0.0, 0.9])),
        'speed_factor_order': int(rng.choice([0, 0, 2])),
        'solver.deadline': 0.3,
        'solver.starts': 2,
    }
    for k in range(count):
        name = f'robot{k + 1}'
        x, y = rng.uniform(0.4, 3.6, size=2)
        values |= {f'{name}.start.x': x, f'{name}.start.y': y}
        values[f'{name}.start.yaw'] = rng.uniform(-3.0, 3.0)
        if rng.uniform() < 0.3:
            values |= {f'{name}.start.{axis}': 0.05 * rng.normal() for axis in ('u', 'v', 'omega')}
    if rng.uniform() < 0.3:
        values['arena.obstacles'] = [*rng.uniform(1.0, 3.0, size=2).tolist(), 0.2]
    return RobotFormation.from_parameters(values)


MAKERS = {'pendulum': pendulum, 'robots': robots}


def published(kind: str, seed: int, counts: Counter[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Plans that leave solvers, each sabotaged in another way, as they are written to files."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            problem = MAKERS[kind](rng)
        except InvalidProblem:
            continue
        sabotage = SABOTEURS[rng.integers(len(SABOTEURS))]
        size = float(np.exp(rng.uniform(math.log(SMALLEST), math.log(LARGEST))))
        counts['attempts'] += 1
        with pytest.MonkeyPatch.context() as patch:
            sabotage(patch, rng, size)
            try:
                solution = problem.solve(seed=int(rng.integers(1000)))
            except Infeasible:
                counts[f'{sabotage.__name__}: none'] += 1
                continue
        counts[f'{sabotage.__name__}: published'] += 1
        text = json.dumps(plan_document(problem, solution), allow_nan=False)
        yield f'{sabotage.__name__} of {size:.2g}', json.loads(text)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize('kind', sorted(MAKERS))
def test_no_plan_that_leaves_a_sabotaged_solver_violates_a_limit(kind: str) -> None:
    counts: Counter[str] = Counter()
    bad = []
    for number, (how, document) in enumerate(published(kind, 2006, counts), 1):
        found = faults(document)
        if found:
            bad.append((how, found, document['parameters']))
        if number == WANTED[kind]:
            break
        assert counts['attempts'] < 50 * WANTED[kind], counts
    print(f'{kind}: {dict(sorted(counts.items()))}')
    assert not bad, f'{len(bad)} of {WANTED[kind]} plans: {bad[:3]}'


@pytest.mark.timeout(1800)
@pytest.mark.parametrize('kind', sorted(MAKERS))
def test_without_the_check_many_would_and_the_check_sees_every_one(kind: str) -> None:
    """The same sabotage of a solver whose check lets everything pass: the suite bites."""
    counts: Counter[str] = Counter()
    violating, unseen = 0, []
    with pytest.MonkeyPatch.context() as patch:
        blind_verification(patch)
        for number, (how, document) in enumerate(published(kind, 3, counts), 1):
            found = faults(document)
            violating += bool(found)
            counts[f'{how.split()[0]}: violates'] += bool(found)
            if found and not document['verification']['reasons']:
                unseen.append((how, found, document['parameters']))
            if number == UNCHECKED:
                break
            assert counts['attempts'] < 50 * UNCHECKED, counts
    print(f'{kind}: {violating} of {number} violate: {dict(sorted(counts.items()))}')
    assert not unseen, f'{len(unseen)} of {violating} are not seen: {unseen[:3]}'
    assert violating >= BITES * number, counts


@pytest.mark.parametrize(
    'sabotage', [s for s in SABOTEURS if s is not nothing], ids=lambda s: s.__name__
)
def test_the_sabotage_is_felt(sabotage: Any) -> None:
    """In its largest size it changes what is found, or leaves nothing: the suite has teeth."""
    rng = np.random.default_rng(1)
    changed = 0
    for problem in (
        PendulumSwingUp(),
        RobotFormation(),
    ):
        right = problem.solve(seed=0)
        with pytest.MonkeyPatch.context() as patch:
            sabotage(patch, rng, 0.3)
            try:
                found = problem.solve(deadline=0.5, seed=0)
            except Infeasible:
                changed += 1
                continue
        changed += found.trajectory.to_dict() != right.trajectory.to_dict()
    assert changed


def test_the_replay_sees_what_is_wrong() -> None:
    """A plan that is changed after its check is told from a right one."""
    problem = PendulumSwingUp()
    document = plan_document(problem, problem.solve())
    assert not faults(document)
    states, controls = document['states'], document['controls']
    factor = 1.0001 / 0.7
    more = {**document, 'controls': {'torque': [factor * x for x in controls['torque']]}}
    assert any('torque' in fault for fault in faults(more))
    late = {**document, 'times': [1.001 * t for t in document['times']]}
    assert any('from the goal' in fault for fault in faults(late))
    moved = {**document, 'states': {**states, 'psi': [x + 0.01 for x in states['psi']]}}
    assert any('begins' in fault for fault in faults(moved))


@pytest.mark.parametrize('sabotage', [saboteurs.wrong_gradients, saboteurs.wrong_model])
def test_the_swing_ups_minimiser_is_reached(sabotage: Any) -> None:
    problem = PendulumSwingUp()
    right = problem.solve(seed=0).trajectory.to_dict()
    with pytest.MonkeyPatch.context() as patch:
        sabotage(patch, np.random.default_rng(1), 0.01)
        try:
            found = problem.solve(deadline=1.0, seed=0).trajectory.to_dict()
        except Infeasible:
            return
    assert found != right
