# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Small parts of nodes on clocks set by hand: instants, rates, shares of time, status, states."""

from types import SimpleNamespace
from unittest.mock import Mock

from action_msgs.msg import GoalStatus
from nav_msgs.msg import Odometry
import pytest
from rclpy.clock import ClockType
from sensor_msgs.msg import JointState
from tdm_planner.nodes import tracker_plans
from tdm_planner.nodes.clocks import MotionClock, pacing_clock, RateWatch
from tdm_planner.nodes.measured_state import LATEST, MeasuredState
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plant_kind import ROBOT
from tdm_planner.tracking.motion import Phase
from tdm_planner.trajectory import SECOND
from trajectory_msgs.msg import JointTrajectory

STATUSES = {name: getattr(GoalStatus, name) for name in dir(GoalStatus) if 'STATUS_' in name}
NAMES = {number: name.removeprefix('STATUS_') for name, number in STATUSES.items()}


def test_of_plans_received_during_an_examination_the_newest_is_examined_next():
    steps = []

    def look_at(stamp, data):
        for step in range(3):
            steps.append((data, step))
            yield

    intake = tracker_plans.PlanIntake(look_at, 1e-9)
    for plan in (b'first', b'second', b'third'):
        intake.waiting = to_stamp(0), plan
        intake.tick()
    for _ in range(3):
        intake.tick()
    intake.begin_anew()  # by another tracker; with no plan that came meanwhile
    intake.tick()
    intake.waiting = to_stamp(0), b'fourth'
    intake.begin_anew()
    for _ in range(9):
        intake.tick()
    told = [(plan, step) for plan in (b'first', b'third') for step in range(3)]
    assert steps == [*told[:5], (b'third', 0), *((b'fourth', step) for step in range(3))]


class SetClock:
    offset = took = 0
    steady, ros_time_is_active = 7 * SECOND, False

    def monotonic_ns(self):
        self.steady += self.took
        return self.steady

    def now(self):
        return SimpleNamespace(nanoseconds=self.steady + 10**18 + self.offset)

    def get_clock(self):
        return self


def tick(watch, rate, seconds):
    for _ in range(round(rate * seconds)):
        watch._clock.steady += round(SECOND / rate)
        watch.tick()


def test_a_rate_that_is_not_held_is_told_once_the_node_has_started_and_a_stall_is_forgotten():
    for rate in (1.0, 7.0, 50.0, 1000.0):
        watch = RateWatch(rate, SetClock())
        tick(watch, rate, 5.0)
        assert (watch.problem(), watch.measured()) == ('', pytest.approx(rate, abs=0.51))
    watch = RateWatch(200.0, SetClock())
    slow = '143 Hz instead of 200: the computer is too busy, lower the rate'
    for rate, seconds, told in ((143.0, 1.0, ''), (143.0, 4.0, slow), (200.0, 5.0, '')):
        tick(watch, rate, seconds)
        assert watch.problem() == told
    watch._clock.steady += SECOND
    assert watch.measured() == pytest.approx(100.0, abs=1.0)
    assert watch.problem()
    tick(watch, 200.0, 2.0)
    assert watch.problem() == ''


def test_a_rate_by_simulated_time_names_the_clock_and_begins_anew_when_that_is_set_back():
    clock = SetClock()
    clock.ros_time_is_active = True
    watch = RateWatch(200.0, clock)
    tick(watch, 50.0, 5.0)
    assert watch.problem().startswith('50 Hz instead of 200: /clock comes too seldom, or the comp')
    tick(watch, 200.0, 5.0)
    clock.steady -= 50 * SECOND
    assert watch.measured() == 0.0
    for seconds in (0.005, 0.1, 1.0, 2.0):
        tick(watch, 200.0, seconds)
        assert (watch.problem(), watch.measured()) == ('', pytest.approx(200.0, rel=0.02))


@pytest.fixture
def day(monkeypatch):
    made = SetClock()
    monkeypatch.setattr('tdm_planner.nodes.clocks.time', made)
    return made


@pytest.mark.parametrize('step', [5.0, 0.001, -86400.0])
def test_a_clock_that_is_set_moves_no_instant(day, step):
    steps: list[float] = []
    motion = MotionClock(day, steps.append)
    assert (pacing_clock(day).clock_type, motion.now()) == (ClockType.STEADY_TIME, 0.0)
    day.steady += SECOND
    assert motion.instant(day.now().nanoseconds) == motion.now() == 1.0
    day.offset += round(step * SECOND)
    for _ in range(2):
        assert (motion.now(), motion.instant(day.now().nanoseconds)) == (1.0, 1.0)
        assert steps == [pytest.approx(step)]


@pytest.mark.parametrize(
    ('offset', 'took', 'steps'), [(999_999, 0, 0), (SECOND, 499_999, 1), (SECOND, 500_000, 0)]
)
def test_jitter_and_a_look_that_is_interrupted_compare_nothing(day, offset, took, steps):
    told: list[float] = []
    motion = MotionClock(day, told.append)
    day.offset, day.took = offset, took
    assert motion.now() == pytest.approx(2 * took * 1e-9)
    assert len(told) == steps


def test_simulated_time_begins_with_the_first_stamp_also_before_the_clock_runs(day):
    day.ros_time_is_active, day.offset = True, -(10**18) - day.steady  # nothing on /clock yet
    motion, first = MotionClock(day), 10**18 + 7
    assert (motion.runs, motion.now()) == (False, 0.0)
    assert motion.instant(first) == 0.0
    day.offset += first + SECOND
    assert (motion.now(), motion.stamp(1.0)) == (1.0, first + SECOND)


class Bench:
    """A tracker whose phase and motions the test sets; `told` is what was published."""

    def __init__(self) -> None:
        self.told: list[dict[int, str]] = []
        self.followed = []
        told = {'tracker_status': self.publish, 'active_trajectory': self.followed.append}
        made = lambda _, topic, *__: SimpleNamespace(publish=told[topic])  # noqa: E731
        self.status = tracker_plans.TrackerStatus(SimpleNamespace(create_publisher=made))
        self.plans, self.reached = {}, None
        self.status.begin()

    def publish(self, message) -> None:
        starts = {nanoseconds_of(each.goal_info.stamp): each for each in message.status_list}
        for start, each in starts.items():
            assert bytes(each.goal_info.goal_id.uuid) == start.to_bytes(16, 'big', signed=True)
        self.told.append({start: NAMES[each.status] for start, each in starts.items()})

    def accept(self, start: int) -> None:
        self.plans[start] = object()
        self.status.accepted(self.plans[start], start, str(start).encode())

    def tracker(self, phase: Phase, *starts: int, braking: bool = False):
        reached = self.reached if phase is Phase.HOLDING else None
        found = [self.plans[start] for start in starts]
        motions = [SimpleNamespace(trajectory=plan, reached=reached) for plan in found]
        made = SimpleNamespace(phase=phase, braking=braking)
        before = [None] * (phase is Phase.WAITING)
        made.current, made.pending = [*before, *motions, None, None][:2]
        made.newest = made.pending or made.current
        return made

    def tick(self, phase: Phase, *starts: int, braking: bool = False) -> dict[int, str]:
        self.status.update(self.tracker(phase, *starts, braking=braking))
        return self.told[-1]


def test_a_plan_from_its_acceptance_to_its_end():
    bench = Bench()
    assert bench.told == [{}]
    bench.accept(5)
    assert bench.tick(Phase.WAITING, 5) == {5: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 5) == {5: 'EXECUTING'}
    bench.tick(Phase.HOLDING, 5)
    bench.reached = True
    assert bench.tick(Phase.HOLDING, 5) == {5: 'SUCCEEDED'}
    bench.tick(Phase.HOLDING, 5)
    assert len(bench.told) == 4  # changes only
    bench.accept(8)
    bench.tick(Phase.HOLDING, 5, 8)
    assert bench.tick(Phase.TRACKING, 8) == {5: 'SUCCEEDED', 8: 'EXECUTING'}
    assert bench.tick(Phase.STOPPED) == {8: 'ABORTED'}
    bench.accept(9)
    assert bench.tick(Phase.WAITING, 9) == {8: 'ABORTED', 9: 'ACCEPTED'}
    bench.reached = False
    assert bench.tick(Phase.HOLDING, 9) == {9: 'ABORTED'}
    bench.status.cancel()
    assert bench.told[-1][9] == 'CANCELED'
    assert bench.followed == [b'5', b'8', JointTrajectory(), b'9', JointTrajectory()]


def test_a_plan_that_is_superseded_is_canceled_and_one_that_is_rejected_aborted():
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    bench.accept(8)
    assert bench.tick(Phase.TRACKING, 5, 8) == {5: 'EXECUTING', 8: 'ACCEPTED'}
    bench.accept(9)
    told = bench.tick(Phase.TRACKING, 5, 9)
    assert told == {5: 'EXECUTING', 8: 'CANCELED', 9: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 9) == {5: 'CANCELED', 9: 'EXECUTING'}
    # the one before goes on
    bench.reached = True
    bench.tick(Phase.HOLDING, 9)
    bench.status.rejected(10, bench.tracker(Phase.HOLDING, 9))
    assert bench.tick(Phase.HOLDING, 9) == {9: 'SUCCEEDED', 10: 'ABORTED'}
    bench.accept(11)
    bench.tick(Phase.HOLDING, 9, 11)
    # refused when it was to begin
    assert bench.tick(Phase.HOLDING, 9) == {9: 'SUCCEEDED', 11: 'ABORTED'}
    assert bench.tick(Phase.STOPPED) == {9: 'ABORTED'}


def test_a_plan_that_starts_later_than_stamps_reach_has_a_status():
    told = tracker_plans.goal_status(2**31 * SECOND + 7, 1).goal_info
    assert (told.stamp.sec, int.from_bytes(told.goal_id.uuid, 'big')) == (
        2**31 - 1,
        2**31 * SECOND + 7,
    )


def test_a_motion_given_up_is_canceling_until_the_plant_is_at_rest():
    bench = Bench()
    bench.accept(5)
    bench.tick(Phase.TRACKING, 5)
    assert bench.tick(Phase.RECOVERING, braking=True) == {5: 'CANCELING'}
    bench.accept(8)
    told = bench.tick(Phase.WAITING, 8, braking=True)
    assert told == {5: 'CANCELING', 8: 'ACCEPTED'}
    assert bench.tick(Phase.TRACKING, 8) == {5: 'ABORTED', 8: 'EXECUTING'}
    assert bench.tick(Phase.RECOVERING, braking=True) == {8: 'CANCELING'}
    assert bench.tick(Phase.RECOVERING) == {8: 'ABORTED'}
    # A tracker that was restarted recovers from a plan that it missed.
    bench.status.rejected(9, bench.tracker(Phase.RECOVERING, braking=True))
    assert bench.tick(Phase.RECOVERING, braking=True)[9] == 'CANCELING'
    assert bench.tick(Phase.RECOVERING)[9] == 'ABORTED'


class Parts:
    """A robot whose odometry and joints come at instants of a clock that is set by hand [ns]."""

    time, runs = 1_700_000_000_000, True

    def __init__(self) -> None:
        self.observe, self.ignore, node = Mock(), Mock(), Mock()
        self.measured = MeasuredState(
            node, self, ROBOT, '', self.observe, self.ignore, lambda: 0.1
        )
        self.callbacks = [call.args[2] for call in node.create_subscription.call_args_list]

    def instant_of(self, stamp) -> float:
        return nanoseconds_of(stamp) * 1e-9 or self.now()

    def now(self) -> float:
        return self.time * 1e-9

    def take(self, stamp: int, message) -> bool:
        message.header.stamp = to_stamp(stamp)
        self.observe.reset_mock()
        self.callbacks[isinstance(message, JointState)](message)
        return [call.args[0][-1] for call in self.observe.call_args_list] == [0.3]

    def joints(self, stamp: int) -> None:
        message = JointState(name=['thruster', 'reaction_wheel'], position=[0.3, 0.0])
        assert not self.take(stamp, message)

    def state(self, stamp: int) -> bool:
        message = Odometry()
        message.pose.pose.orientation.w = 1.0
        return self.take(stamp, message)


def test_stamps_may_differ_by_the_timeout():
    parts, begin = Parts(), Parts.time
    assert not parts.state(begin)  # without joints there is none
    parts.ignore.assert_not_called()
    for milliseconds, fits in ((-101, False), (-99, True), (99, True), (101, False)):
        parts = Parts()
        parts.joints(begin)
        parts.time += 3600 * SECOND  # by what clock it came is no matter
        assert parts.state(begin + milliseconds * 1_000_000) is fits
        told = [call.args[0] for call in parts.ignore.call_args_list]
        assert fits is (not told)
        assert all('0.101 s apart, more than state_timeout = 0.1 s' in text for text in told)


def test_a_state_that_is_overtaken_is_dropped_unless_a_clock_was_set_back():
    parts, begin = Parts(), Parts.time
    parts.joints(begin)
    parts.time += SECOND
    late = round((LATEST - 0.01) * SECOND)
    for stamp, taken in ((5, True), (4, False), (5 - late, False), (5, True), (6, True)):
        assert parts.state(begin + stamp) is taken
    for back in (1, 3600):
        parts.time -= back * SECOND
        parts.joints(parts.time)
        assert parts.state(parts.time)
    parts.time += 60 * SECOND
    parts.joints(parts.time)
    assert parts.state(parts.time)
    slow = parts.time - round((LATEST + 0.01) * SECOND)  # the clock of the plant alone
    parts.joints(slow)
    assert parts.state(slow)
    parts.ignore.assert_not_called()


def test_a_state_that_comes_while_one_is_read_is_not_mixed_with_it():
    """As in the thread that plans."""

    class Growing(dict):
        """A state comes as soon as the ones there are were read."""

        def values(self):
            read = [*super().values()]
            self['odom'] = self['odom'][0], later
            return read

    parts, begin = Parts(), Parts.time
    parts.joints(begin)
    parts.state(begin)
    measured, later = parts.measured, begin * 1e-9 + 0.005
    for read in (lambda: measured.newest, lambda: measured.fresh(begin * 1e-9, 1.0)):
        measured._newest = Growing(measured._newest)
        _, instant = read()
        assert instant == begin * 1e-9


@pytest.mark.parametrize('stamps', [(0, 0), (Parts.time, 0), (0, Parts.time + 90_000_000)])
def test_without_stamps_it_is_when_they_come(stamps):
    parts = Parts()
    parts.joints(stamps[0])
    parts.time += 90_000_000
    assert parts.state(stamps[1])
    parts.time += 20_000_000
    assert parts.state(stamps[1] and stamps[1] + 20_000_000) is False
