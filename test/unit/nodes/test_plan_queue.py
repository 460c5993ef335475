# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the planner computes, in which order; recovery of plans, and where they lead meanwhile."""

from __future__ import annotations

from collections.abc import Callable
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tdm_planner.exceptions import Busy, Inactive
from tdm_planner.nodes import other_planners
from tdm_planner.nodes.adapter import ActivePlans
from tdm_planner.nodes.plan_queue import PlanQueue
from tdm_planner.nodes.planned_plants import PlannedRobots
from tdm_planner.nodes.replanning import Replanning
from tdm_planner.nodes.vehicle import Vehicle
from tdm_planner.parameters import to_mapping
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.replanning import ActivePlan, Outlook, Review
from tdm_planner.trajectory import TimedTrajectory
from tdm_planner.verification import replay

SILENT = SimpleNamespace(info=lambda *_, **__: None, warning=lambda *_, **__: None)


class Queue(PlanQueue):
    """Computations end when the test says so: `began` holds their names, `done` what came."""

    def __init__(self) -> None:
        self.delivered = threading.Event()
        super().__init__(SimpleNamespace(executor=self))  # type: ignore[arg-type]
        self.began: list[str] = []
        self.done: list[Any] = []
        self.go = threading.Event()

    def create_task(self, deliver: Callable[..., None], *what: Any) -> None:
        self.task_of_executor = lambda: deliver(*what)
        self.delivered.set()

    def job(self, name: str) -> tuple[Callable[[], str], Callable[[Any], None]]:
        def compute() -> str:
            self.began.append(name)
            assert self.go.wait(20.0)
            if name == 'fault':
                raise ValueError(name)
            return name

        return compute, self.done.append

    def finish(self) -> None:
        """Let the computation under way end, and the executor take its outcome."""
        self.go.set()
        assert self.delivered.wait(20.0)
        self.go.clear()
        self.delivered.clear()
        self.task_of_executor()


@pytest.fixture
def queue() -> Queue:
    return Queue()


def test_a_request_is_solved_before_tasks_and_a_second_one_is_busy(queue: Queue) -> None:
    queue.task(*queue.job('first task'))
    queue.task(*queue.job('second task'))
    assert not queue.solving
    queue.request(*queue.job('request'))
    queue.review(*queue.job('review'))
    for _ in range(2):  # while it waits, and while it is solved
        assert queue.solving
        with pytest.raises(Busy):
            queue.request(*queue.job('another'))
        queue.finish()
    assert not queue.solving
    queue.finish()
    assert queue.done == ['first task', 'request', 'second task']


def test_a_request_supersedes_a_review(queue: Queue) -> None:
    queue.review(*queue.job('review'))
    queue.review(*queue.job('review too much'))
    queue.request(*queue.job('request'))
    queue.finish()
    queue.finish()
    assert queue.began == ['review', 'request']
    assert queue.done == ['request']
    queue.review(*queue.job('later review'))
    queue.finish()
    assert queue.done[1:] == ['later review']


def test_what_is_cancelled_is_answered_and_its_outcome_dropped(queue: Queue) -> None:
    queue.request(*queue.job('request'))
    queue.task(*queue.job('task'))
    error = Inactive('deactivated')
    queue.cancel(error)
    queue.cancel(error)
    assert queue.done == [error]
    with pytest.raises(Busy):  # it cannot be interrupted
        queue.request(*queue.job('too soon'))
    queue.finish()
    queue.request(*queue.job('next'))
    queue.finish()
    assert queue.began == ['request', 'next']
    assert queue.done == [error, 'next']


def test_what_a_computation_raises_is_its_outcome(queue: Queue) -> None:
    queue.request(*queue.job('fault'))
    queue.finish()
    assert [type(outcome) for outcome in queue.done] == [ValueError]


class Reviewed:
    """A planner's review under way, of a plan with parameters of its own."""

    def __init__(self) -> None:
        self.published: list[ActivePlan] = []
        self.now, self.values = 0.0, {**to_mapping(ReplanParameters(), 'replan.'), 'wide': 1.0}
        clock: Any = SimpleNamespace(now=lambda: self.now)
        node: Any = SimpleNamespace(
            get_logger=lambda: SILENT, active=True, parameter_values=self.values
        )
        queue: Any = self
        adapter: Any = SimpleNamespace(
            measures=True, inactive=[], observations=lambda values, *_: self.seen.append(values)
        )
        self.seen: list[Any] = []
        self.replanning = Replanning(node, clock, queue, adapter, self.published.append)
        problem: Any = 'problem'
        solution: Any = 'solution'
        self.replanning.follow(ActivePlan(problem, solution, 0.0, own={'wide': 2.0}))
        self.replanning._on_timer()

    def drop_review(self) -> None:
        pass

    def review(self, compute: Any, done: Callable[[Any], None]) -> None:
        self.done = done

    def finish(self) -> None:
        made = ActivePlan('problem', 'solution', 0.5)  # type: ignore[arg-type]
        self.done(Review(made, 'the problem has changed', Outlook(), True))


def test_a_review_asks_with_the_plans_own_parameters_and_a_late_plan_is_dropped() -> None:
    review = Reviewed()
    assert review.seen == [{**review.values, 'wide': 2.0}]
    review.finish()
    assert [plan.start for plan in review.published] == [0.5]
    review.now += 0.6
    review.finish()
    assert len(review.published) == 1
    assert review.replanning._last == 'a new plan came 0.100 s late'


class Restarted:
    """A planner being restarted, of two vehicles whose trackers tell what they follow."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.active = 100.0, False
        self.taken: list[tuple[list[str], int]] = []
        monkeypatch.setattr(other_planners, 'time', SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr(other_planners, 'read_plan', lambda _, message: message.plan)
        self.takes: list[Callable[[Any], None]] = []
        node: Any = SimpleNamespace(create_subscription=self.subscribe)
        vehicles: Any = [SimpleNamespace(name=n, prefix=f'{n}/', kind=None) for n in 'ab']
        self.recovery = other_planners.Recovery(node, vehicles)

    def subscribe(self, _: Any, topic: str, take: Callable[[Any], None], *more: Any) -> None:
        assert topic.endswith('/active_trajectory')
        self.takes.append(take)

    def told(self, plan: str, *starts: int) -> None:
        """Let the trackers tell of a plan's start [s], one after the other; 0: of none."""
        for take, start in zip(self.takes, starts, strict=True):
            header = SimpleNamespace(stamp=SimpleNamespace(sec=start, nanosec=0))
            points = [1, 2] if start else []
            take(SimpleNamespace(header=header, points=points, plan=plan))
            self.later(0.0)

    def later(self, seconds: float) -> None:
        self.now += seconds
        found = self.recovery.look(self.active)
        if found is not None:
            self.taken.append((list(found[0].values()), found[1] // 10**9))  # type: ignore


@pytest.fixture
def restarted(monkeypatch: pytest.MonkeyPatch) -> Restarted:
    return Restarted(monkeypatch)


def test_what_is_followed_when_it_starts_is_taken_over(restarted: Restarted) -> None:
    restarted.active = True
    restarted.told('A', 1, 1)
    assert restarted.taken == []
    restarted.later(1.0)
    assert restarted.taken == [(['A', 'A'], 1)]
    restarted.later(1.0)
    restarted.now += other_planners.WINDOW
    restarted.told('B', 2, 2)
    restarted.later(60.0)
    assert len(restarted.taken) == 1


@pytest.mark.parametrize(('delay', 'starts'), [(0.0, (1, 2)), (0.0, (1, 0)), (11.0, (1, 1))])
def test_what_not_all_follow_or_begins_long_after_it_started_is_not(restarted, delay, starts):
    restarted.active = True
    restarted.now += delay
    restarted.told('A', *starts)
    restarted.later(60.0)
    assert restarted.taken == []


@pytest.mark.parametrize(('start', 'taken'), [(0, []), (2, [(['B', 'B'], 2)])])
def test_what_was_given_up_before_it_was_activated_is_forgotten(restarted, start, taken):
    restarted.told('A', 1, 1)
    restarted.later(30.0)
    restarted.told('B', start, start)
    restarted.active = True
    restarted.later(1.0)
    assert restarted.taken == taken


START = 1_700.0


@pytest.fixture(scope='module')
def plan():
    solution = RobotFormation().solve(deadline=10.0)
    plant = FloatingRobot()
    return TimedTrajectory(solution.trajectories['robot1'].with_rates(plant.derivative), START)


class Robot(Vehicle):
    """A robot that follows a plan, measured in a state at an instant."""

    def __init__(self, plan: TimedTrajectory | None, state: Any, measured: float) -> None:
        self._plant = PlannedRobots(RobotFormation, {})
        self._angles = np.isin(np.arange(7), (4, 6))
        self.measured = SimpleNamespace(fresh=lambda *_: (state, measured))  # type: ignore
        self.follows = lambda *_: plan  # type: ignore[method-assign, assignment]


def predict(plan, state, measured, start):
    active: Any = plan
    robot = Robot(plan, state, measured)
    return robot.predicted({'start.max_age': 1.0}, measured, start, active)


@pytest.mark.parametrize('at', [0.2, 1.3, 3.3])
def test_a_robot_that_follows_its_plan_is_met_on_it(plan, at):
    """Under full thrust drifting alone would miss by ten centimetres."""
    times = np.array([at, at + 1.0])
    before, after = replay(FloatingRobot(), plan.trajectory, times)
    measured = START + at
    predicted = predict(plan, before, measured, measured + 1.0)
    np.testing.assert_allclose(predicted[:6], after[:6], atol=1e-3)


def test_a_robot_that_does_not_follow_drifts(plan):
    state = np.array([1.0, 1.0, 0.1, 0.0, 0.0, 0.2, 0.5])
    for force in (plan, None):
        predicted = predict(force, state, START + 9.0, START + 10.0)
        np.testing.assert_allclose(predicted, [1.1, 1.0, 0.1, 0.0, 0.2, 0.2, 0.5], atol=1e-12)


def test_until_a_plan_begins_the_one_before_is_carried_out(plan):
    def begins(start):
        return TimedTrajectory(plan.trajectory, start)

    plans = ActivePlans()
    assert plans.at(9.0) is plans.next_start(9.0) is None
    first, third = begins(10.0), begins(20.0)
    plans.add(first, 9.0)
    assert plans.at(9.0) is None
    assert plans.next_start(9.0) == 10.0
    assert plans.at(11.0) is first
    plans.add(begins(19.0), 18.0)
    assert plans.at(18.0) is first
    plans.add(third, 18.1)
    # The second one never begins.
    assert plans.at(19.0) is first
    assert plans.next_start(19.9) == 20.0
    assert plans.next_start(20.0) is None
    assert plans.at(20.0) is third


def test_a_small_deviation_is_carried_along(plan):
    measured = START + 2.0
    state = plan.reference(measured) + np.array([0.02, 0, 0, 0.01, 0, 0, 0])
    away = predict(plan, state, measured, measured + 1.0) - plan.reference(measured + 1.0)
    np.testing.assert_allclose(away[:4], [0.02, 0.01, 0.0, 0.01], atol=1e-9)
