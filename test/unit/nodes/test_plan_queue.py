# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the planner computes, in which order; recovery of plans, and where they lead meanwhile."""

from collections.abc import Callable
from functools import partial
import threading
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from tdm_planner.exceptions import Busy, Failure, Inactive
from tdm_planner.nodes import tracker_plans
from tdm_planner.nodes.adapter import Vehicle
from tdm_planner.nodes.planning import await_trackers, PlanQueue, Replanning
from tdm_planner.parameters import to_mapping
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.robot_replay import replay
from tdm_planner.problems import RobotFormation
from tdm_planner.problems.planner_parameters import ReplanParameters
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.replanning.planned_plants import planned_plant
from tdm_planner.replanning.replanner import PublishedPlans, Replanner, Review
from tdm_planner.trajectory import TimedTrajectory

START = 1_700.0  # s


class Queue(PlanQueue):
    """Computations end when the test says so: `began` holds their names, `done` what came."""

    def __init__(self) -> None:
        self.delivered = threading.Event()
        super().__init__(SimpleNamespace(executor=self))  # type: ignore[arg-type]
        self.began: list[str] = []
        self.done = []
        self.go = threading.Event()

    def create_task(self, deliver: Callable[..., None], *what) -> None:
        self.task_of_executor = lambda: deliver(*what)
        self.delivered.set()

    def job(self, name: str) -> tuple[Callable[[], str], Callable]:
        def compute() -> str:
            self.began.append(name)
            assert self.go.wait(20.0)
            if name == 'fault':
                raise ValueError(name)
            return name

        return compute, self.done.append

    def finish(self) -> None:
        self.go.set()
        assert self.delivered.wait(20.0)
        self.go.clear()
        self.delivered.clear()
        self.task_of_executor()


def test_a_request_waits_for_what_prepares_it_and_a_second_one_is_busy() -> None:
    queue = Queue()
    queue.prepare(*queue.job('preparing'))
    assert not queue.solving
    queue.request(*queue.job('request'))
    queue.review(*queue.job('review'))
    for _ in range(2):  # while it waits, and while it is solved
        assert queue.solving
        with pytest.raises(Busy):
            queue.request(*queue.job('another'))
        queue.finish()
    assert not queue.solving
    assert queue.done == ['preparing', 'request']


def test_what_is_recovered_comes_before_the_request_that_is_planned_along_it() -> None:
    queue = Queue()
    queue.prepare(*queue.job('preparing'))
    queue.prepare(lambda: None, lambda _: queue.prepare(*queue.job('found')))
    queue.request(*queue.job('request'))
    queue.finish()
    for _ in range(3):
        queue.finish()
    assert queue.done == ['preparing', 'found', 'request']


def test_a_request_supersedes_a_review() -> None:
    queue = Queue()
    queue.review(*queue.job('review'))
    queue.review(*queue.job('review too much'))
    queue.request(*queue.job('request'))
    queue.finish()
    queue.finish()
    assert (queue.began, queue.done) == (['review', 'request'], ['request'])
    queue.review(*queue.job('later review'))
    queue.finish()
    assert queue.done[1:] == ['later review']


def test_what_is_cancelled_is_answered_and_what_is_raised_is_an_outcome() -> None:
    queue = Queue()
    queue.request(*queue.job('request'))
    queue.prepare(*queue.job('preparing'))
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
    queue.request(*queue.job('fault'))
    queue.finish()
    assert queue.done[:2] == [error, 'next']
    assert isinstance(queue.done[2], ValueError)


def test_a_review_asks_with_the_plans_own_parameters_and_a_late_plan_is_dropped(monkeypatch):
    values = {**to_mapping(ReplanParameters(), 'replan.'), 'wide': 1.0}
    it = Mock(active=True, vehicles={}, parameter_values={**values, 'start.max_age': 1.0})
    it.now.return_value, it.plans = 0.0, PublishedPlans()
    replanning = Replanning(it, it, it, it, it.publish)
    kind = type('Kind', (), {'from_parameters': dict, 'to_parameters': lambda _: {'wide': 1.0}})
    plan = partial(TimedPlan, kind(), Mock())
    it.plans.add(plan(0.0, request_parameters={'wide': 2.0}))
    it.of_all.return_value = {}
    replanning._on_timer()
    ((review, done), _) = it.review.call_args
    monkeypatch.setattr(Replanner, 'review', lambda self, asked, *_: asked)
    assert review() == {**it.parameter_values, 'wide': 2.0}
    for _ in range(2):
        done(Review(plan(0.5), 'the problem has changed', True))
        assert [call.args[0].start for call in it.publish.call_args_list] == [0.5]
        it.now.return_value += 0.6
    assert replanning._last == 'a new plan came 0.100 s late'


def test_a_computation_that_ends_its_thread_is_a_fault_and_the_next_one_runs():
    queue = Queue()
    queue.request(Mock(side_effect=SystemExit(1)), queue.done.append)
    queue.finish()
    (fault,) = queue.done
    assert Failure.of(fault).code == 'INTERNAL'
    assert 'SystemExit' in Failure.of(fault).trace
    queue.request(*queue.job('next'))
    queue.finish()
    assert queue.done[1:] == ['next']


class Restarted:
    """A planner being restarted, of two vehicles whose trackers tell what they follow."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.active = 100.0, False
        self.taken: list[tuple[list[str], int]] = []
        monkeypatch.setattr(tracker_plans, 'time', SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr(tracker_plans, 'read_plan', lambda _, message: message.plan)
        node = Mock()
        self.trackers = [SimpleNamespace(prefix=f'{name}/', has_plan=None) for name in 'ab']
        trackers = dict(zip('ab', self.trackers, strict=True))
        self.recovery = tracker_plans.Recovery(node, None, trackers)  # type: ignore
        self.takes = {c.args[1]: c.args[2] for c in node.create_subscription.call_args_list}
        assert list(self.takes) == ['a/active_trajectory', 'b/active_trajectory']

    def told(self, plan: str, *starts: int) -> None:
        """Let the trackers tell of a plan's start [s], one after the other; 0: of none."""
        for take, start in zip(self.takes.values(), starts, strict=True):
            header = SimpleNamespace(stamp=SimpleNamespace(sec=start, nanosec=0))
            take(SimpleNamespace(header=header, points=[1, 2] if start else [], plan=plan))
            self.later(0.0)

    def later(self, seconds: float) -> None:
        self.now += seconds
        found = self.recovery.look(self.active)
        if found is not None:
            self.taken.append((list(found[0].values()), found[1] // 10**9))  # type: ignore


@pytest.mark.parametrize('missing', [None, True])
def test_a_tracker_that_is_there_is_waited_for(monkeypatch, missing) -> None:
    restarted = Restarted(monkeypatch)
    recovery, (first, second) = restarted.recovery, restarted.trackers
    first.has_plan, second.has_plan = False, missing  # the first one follows nothing
    assert recovery.due
    waited = threading.Thread(target=await_trackers, args=(recovery,), daemon=True)
    waited.start()
    restarted.told('A', 0, 1)
    assert recovery.due == (missing is None)  # its status may come after what it follows
    second.has_plan = True
    waited.join(20.0)
    assert not waited.is_alive()
    assert not recovery.due
    restarted = Restarted(monkeypatch)
    assert restarted.recovery.due
    restarted.later(tracker_plans.WINDOW)
    assert not restarted.recovery.due
    restarted = Restarted(monkeypatch)
    for tracker in restarted.trackers:
        tracker.has_plan = False
    assert not restarted.recovery.due


def test_what_is_followed_when_it_starts_is_taken_over(monkeypatch) -> None:
    restarted = Restarted(monkeypatch)
    restarted.active = True
    restarted.told('A', 1, 1)
    assert restarted.recovery.due  # that they follow it is not told yet
    for seconds in (0.0, 1.0, tracker_plans.WINDOW):
        restarted.later(seconds)
        assert restarted.taken == [(['A', 'A'], 1)]
    assert not restarted.recovery.due
    restarted.told('B', 2, 2)
    restarted.later(60.0)
    assert len(restarted.taken) == 1


@pytest.mark.parametrize(('delay', 'starts'), [(0.0, (1, 2)), (0.0, (1, 0)), (11.0, (1, 1))])
def test_what_not_all_follow_or_begins_long_after_it_started_is_not(monkeypatch, delay, starts):
    restarted = Restarted(monkeypatch)
    restarted.active = True
    restarted.now += delay
    restarted.told('A', *starts)
    restarted.later(60.0)
    assert restarted.taken == []


@pytest.mark.parametrize(('start', 'taken'), [(0, []), (2, [(['B', 'B'], 2)])])
def test_what_was_given_up_before_it_was_activated_is_forgotten(monkeypatch, start, taken):
    restarted = Restarted(monkeypatch)
    restarted.told('A', 1, 1)
    restarted.later(30.0)
    restarted.told('B', start, start)
    restarted.active = True
    restarted.later(1.0)
    assert restarted.taken == taken


@pytest.fixture(scope='module')
def plan():
    solution = RobotFormation().solve(deadline=10.0)
    plant = FloatingRobot()
    return TimedTrajectory(solution.trajectories['robot1'].with_rates(plant.derivative), START)


def predict(plan, state, measured, start):
    seen = SimpleNamespace(fresh=lambda *_: (state, measured))
    robot = SimpleNamespace(measured=seen, followed_motion=lambda *_: plan)
    robot._plant = planned_plant(RobotFormation, {})
    robot._angles = np.isin(np.arange(7), (4, 6))
    return Vehicle.predicted(robot, {'start.max_age': 1.0}, measured, start, PublishedPlans())


@pytest.mark.parametrize('at', [0.2, 1.3, 3.3])
def test_a_robot_that_follows_its_plan_is_met_on_it_and_another_drifts(plan, at):
    times = np.array([at, at + 1.0])
    before, after = replay(FloatingRobot(), plan.trajectory, times)
    measured = START + at
    predicted = predict(plan, before, measured, measured + 1.0)
    np.testing.assert_allclose(predicted[:6], after[:6], atol=1e-3)
    state = plan.reference(measured) + np.array([0.02, 0, 0, 0.01, 0, 0, 0])
    away = predict(plan, state, measured, measured + 1.0) - plan.reference(measured + 1.0)
    np.testing.assert_allclose(away[:4], [0.02, 0.01, 0.0, 0.01], atol=1e-9)
    state = np.array([1.0, 1.0, 0.1, 0.0, 0.0, 0.2, 0.5])
    for force in (plan, None):
        predicted = predict(force, state, START + 9.0, START + 10.0)
        np.testing.assert_allclose(predicted, [1.1, 1.0, 0.1, 0.0, 0.2, 0.2, 0.5], atol=1e-12)
