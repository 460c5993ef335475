# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What all problems share: the outer loop of the search, recovered plans, the registry."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
import re
import sys
from unittest.mock import Mock

import numpy as np
from planned_apart import planned_apart
import pytest
from stated import Cart, changed
from tdm_planner import cli
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.problems import PendulumSwingUp, Problem, RobotFormation, Solution
from tdm_planner.problems.pendulum.smooth import StatedSwingUp
from tdm_planner.problems.problem import Search
from tdm_planner.problems.registry import load_problem, problem_names
from tdm_planner.verification import Verification


class Scripted(Search[float]):
    """Rounds of candidates as given; the k-th plan of a candidate c costs c and passes if told."""

    def __init__(self, rounds, passing, satisfying=None, seconds=60.0) -> None:
        super().__init__(Budget(seconds))
        self.rounds, self.passing, self.satisfying = rounds, passing, satisfying
        self.round = 0
        self.checked: list[tuple[float, int]] = []

    def candidates(self) -> Iterable[float]:
        return self.rounds[self.round]

    def plans(self, candidate: float) -> Iterator[Solution]:
        for k in range(3):
            self.checked.append((candidate, k))
            ok = self.passing.get(candidate, 9) == k
            reasons = () if ok else (f'plan {k} of {candidate:g} fails',)
            check = Verification(ok=ok, terminal_error=np.zeros(1), reasons=reasons)
            yield Solution({}, check, candidate, np.zeros(0), 0.0)

    def accept(self, plan: Solution) -> bool:
        return self.satisfying is None or plan.cost in self.satisfying

    def widen(self) -> bool:
        self.round += 1
        return self.round < len(self.rounds)

    def failure(self) -> Infeasible:
        return Infeasible(self.rejected or 'nothing found')


Ordered = changed(Scripted, is_worth_checking=lambda search, cost, plan: cost < plan.cost)
PATIENT = {'solver.deadline': 60.0}


def test_the_first_satisfying_plan_ends_the_search_or_the_cheapest_of_a_round() -> None:
    search = Scripted([[1.0, 2.0]], {1.0: 1, 2.0: 0})
    assert (search.run().cost, search.checked) == (1.0, [(1.0, 0), (1.0, 1)])
    assert search.rejected == 'plan 0 of 1 fails'
    search = Scripted([[], [5.0], [4.0]], {4.0: 0, 6.0: 0})
    assert (search.run().cost, search.round) == (4.0, 2)
    # Where none satisfies it is the cheapest; what promises no more is not checked.
    for kind, checked in ((Scripted, {2.0, 3.0, 1.0}), (Ordered, {2.0, 1.0})):
        search = kind([[2.0, 3.0, 1.0]], {1.0: 2, 2.0: 0, 3.0: 0}, satisfying=set())
        assert (search.run().cost, {c for c, _ in search.checked}) == (1.0, checked)


def test_failure_is_raised_with_the_last_reason() -> None:
    late = Scripted([[1.0], [2.0]], {2.0: 0}, seconds=0.0)  # no further round
    for search, words, round_ in (
        (Scripted([[6.0, 7.0]], {}), 'plan 2 of 7 fails', 1),
        (Scripted([[]], {}), 'nothing found', 1),
        (late, 'of 1 fails', 0),
    ):
        with pytest.raises(Infeasible, match=words):
            search.run()
        assert search.round == round_


OF_NUMBERS = OverflowError('math range error'), FloatingPointError('the motion is too fast')
OTHERS = ZeroDivisionError(), np.linalg.LinAlgError(), ValueError(), IndexError()


@pytest.mark.parametrize('error', [*OF_NUMBERS, *OTHERS])
def test_numbers_out_of_range_are_the_users_and_other_errors_pass_unchanged(monkeypatch, error):
    monkeypatch.setattr(PendulumSwingUp, 'standing_plan', Mock(side_effect=error))
    with pytest.raises((Infeasible, type(error))) as caught:
        PendulumSwingUp().solve()
    if error in OTHERS:
        assert caught.value is error
    else:
        assert f'{error}' in str(caught.value)
        assert 'are their units right' in str(caught.value)
        assert caught.value.__cause__ is error


@pytest.mark.parametrize('kind', [PendulumSwingUp, RobotFormation])
def test_a_plan_is_recognised_with_its_cost_and_replanned_from_alike(kind):
    problem = kind.from_parameters(PATIENT)
    solution = problem.solve()
    found = problem.recovered(solution.trajectories)
    assert (found.cost, found.cost_terms) == (solution.cost, solution.cost_terms)
    assert found.summary == solution.summary
    assert found.verification.worst == solution.verification.worst
    assert set(found.verifications) == set(solution.verifications)
    again = [problem.solve(warm_start=plan) for plan in (solution, found)]
    assert again[1].evaluations == again[0].evaluations < solution.evaluations
    assert again[1].cost == pytest.approx(again[0].cost, rel=1e-9)
    if isinstance(problem, PendulumSwingUp):  # the arcs are found again
        np.testing.assert_allclose(found.parameters, solution.parameters, atol=1e-8)
        largest = np.abs(solution.trajectory.controls).max()
        weaker = PendulumSwingUp.from_parameters({'limits.torque': 0.9 * float(largest)})
        with pytest.raises(VerificationFailed, match='torque'):
            weaker.recovered(solution.trajectories)
    # What does not reach the goal, or cannot be assessed, is not recognised.
    motions = solution.trajectories.items()
    spoilt = {name: replace(plan, controls=0.9 * plan.controls) for name, plan in motions}
    with pytest.raises(VerificationFailed):
        problem.recovered(spoilt)
    silent = changed(type(problem), assess=Problem.assess).from_parameters({})
    with pytest.raises(VerificationFailed, match='cannot assess'):
        silent.recovered(solution.trajectories)


def test_a_recognised_plan_that_does_nothing_has_no_arcs():
    problem = PendulumSwingUp.from_parameters({'start.theta': 0.0})
    found = problem.recovered(problem.solve().trajectories)
    assert not found.parameters.size
    moved = PendulumSwingUp.from_parameters({'start.theta': 0.3, **PATIENT})
    assert moved.solve(warm_start=found).verification.ok


def test_a_goal_that_fails_late_leaves_what_is_left_to_the_next(monkeypatch) -> None:
    goals = []

    def search(stated, until, rng, previous):
        goals.append(stated.goal)
        until.evaluations += 7  # of ten that are the deadline
        return Mock(run=Mock(side_effect=Infeasible('none')))

    monkeypatch.setattr(StatedSwingUp, 'search', search)
    problem, budget = PendulumSwingUp(method='virtual_arc'), Budget(1.0, evaluations=10)
    with pytest.raises(Infeasible):
        problem.search(budget, np.random.default_rng(0), None).run()
    assert sorted(goals) == [0.0, 2.0 * np.pi]


def test_processes_and_the_order_of_sets_change_nothing() -> None:
    assert planned_apart(PYTHONHASHSEED='0') == planned_apart(PYTHONHASHSEED='1')


def test_the_packages_own_and_another_packages_are_loaded_or_refused(tmp_path, monkeypatch):
    metadata = tmp_path / 'another-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: another\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(
        '[tdm_planner.problems]\nanother = another_package:Another\nbroken = broken_package:A\n'
        'a_function = another_package:solve\nnothing = another_package:Missing\n'
        'pendulum_swing_up = another_package:Another\n'
    )
    (tmp_path / 'another_package.py').write_text(
        'from tdm_planner.problems import PendulumSwingUp\n'
        'class Another(PendulumSwingUp): name = "another"\ndef solve(): pass\n'
    )
    (tmp_path / 'broken_package.py').write_text('1 / 0\n')
    (tmp_path / 'absent_cart.py').write_text('import absent\n')
    (tmp_path / 'ended_cart.py').write_text('import sys\nsys.exit(3)\n')
    (tmp_path / 'calendar.py').write_text('')
    (tmp_path / 'wordy_cart.py').write_text("raise ValueError('no\\nwheels')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', [*sys.path, str(tmp_path)])
    assert load_problem('pendulum_swing_up') is PendulumSwingUp
    assert problem_names()[:2] == ['pendulum_swing_up', 'robot_formation']
    assert load_problem('another').name == 'another'
    assert {'another', 'broken'} <= set(problem_names())
    for name, says in (
        ('anothr', r"parameter 'problem' = 'anothr' .* \(did you mean another or nothing\?\)"),
        ('zzz', "'zzz' is not allowed: must be one of pendulum_swing_up, .*my_module:MyP"),
        (
            'a_function',
            'from another_package:solve: solve does not derive from DirectProblem or Problem',
        ),
        ('nothing', r"has no attribute 'Missing' \(it has no such class\)$"),
        ('another_package:Anothr', r'cannot be loaded: Attr.* \(did you mean Another\?\)$'),
        ('./another_package:Another', 'such as another_package:Another in the folder'),
        ('broken', 'ZeroDivisionError: division by zero'),
        ('nowhere:Cart', r"No module named 'nowhere' \(write module:Class, and run it in"),
        ('ended_cart:Cart', r'SystemExit: 3 in line 2 of ended_cart.py, `sys.exit\(3\)`$'),
        ('wordy_cart:Cart', 'ValueError: no wheels in line 1 of wordy_cart.py'),
        ('calendar:Cart', r'\(it is that of /.*/calendar.py: rename calendar.py\)$'),
        ('absent_cart:Cart', "'absent' in line 1 of absent_cart.py, `import absent`$"),
    ):
        with pytest.raises(InvalidProblem, match=says):
            load_problem(name)


def test_poses_of_a_formation_are_checked_and_kept_as_they_were_given() -> None:
    place = [0.45, 0.0, 0.0]
    formation = RobotFormation(offsets={'robot1': place})
    place[0] = 99.0
    assert formation.to_parameters()['formation.robot1'] == [0.45, 0.0, 0.0]
    assert formation.offsets['robot1'] == [0.45, 0.0, 0.0]
    for kind, value, told in (
        (
            'offsets',
            [0.1, 0.2],
            "'formation.robot1' = [0.1, 0.2] is not allowed: must be a list of 3",
        ),
        ('starts', {'x': 1.0}, "starts['robot1'] = {'x': 1.0} must be a RobotStart"),
    ):
        with pytest.raises(InvalidProblem, match=re.escape(told)):
            RobotFormation(**{kind: {'robot1': value}})


def test_a_warm_start_has_no_more_arcs_than_are_allowed() -> None:
    starts = {'theta': -1.0, 'psi': 0.3, 'theta_dot': 2.0, 'psi_dot': -1.0}
    for arcs in (4, 5):
        given = {f'start.{name}': value for name, value in starts.items()}
        problem = PendulumSwingUp.from_parameters(
            given | {'switching_arcs': arcs, 'limits.torque': 0.09}
        )
        plan = problem.solve(counted=True)
        for seed in range(6):
            again = problem.solve(counted=True, warm_start=plan, seed=seed)
            assert again.trajectory.switches.size < arcs


def test_one_way_upright_is_told_to_begin_there() -> None:
    given = {'method': 'virtual_arc', 'start.theta': 0.0, 'start.psi': 1.0}
    with pytest.raises(Infeasible, match='but the pendulum starts upright; method'):
        PendulumSwingUp.from_parameters(given).solve(counted=True)


def test_names_with_brackets_are_shown_as_they_are(monkeypatch, capsys):
    names = {'state_names': ('x [m]', 'v [/s]'), 'control_names': ('u [a]',)}
    monkeypatch.setattr(cli, 'load_problem', lambda _: changed(Cart, **names))
    assert cli.main(['check', 'any']) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in ('x [m]', 'v [/s]', 'u [a]'))
