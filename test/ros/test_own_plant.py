# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Problems and plants as another package would bring them: planned for, simulated, tracked, drawn.

And what their solvers, drawings and parameters can do to the nodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from action_msgs.msg import GoalStatus, GoalStatusArray
from double_integrator import CartStart, DoubleIntegrator
from marker_checks import check_markers, Scene
import numpy as np
import pytest
from ros_harness import Space
from sensor_msgs.msg import JointState
from stated import changed
from stepped_ros import Stepped
from tdm_planner.drawing import Box, Disc, Line, Shape
from tdm_planner.exceptions import Infeasible, InvalidProblem, VerificationFailed
from tdm_planner.nodes.markers import LIFETIME
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.parameters import group, parameter
from tdm_planner.problems import PendulumSwingUp, Problem, Solution, SolverParameters
from visualization_msgs.msg import Marker

FAILURES = {  # of a solver: the error, then code, reason and level
    'crash': (ZeroDivisionError('a\nbug'), 'INTERNAL', 'ZeroDivisionError: a bug', 2),
    'missed': (VerificationFailed('it\nmisses'), 'VERIFICATION_FAILED', 'it misses', 1),
    'infeasible': (Infeasible('too weak'), 'INFEASIBLE', 'too weak', 1),
}  # fmt: skip
LOOPS = {'acrobot:Acrobot': True, 'overtaking:Overtaking': False}  # whether its end can be held
ALLOWED = 0.02  # largest deviation where it is held, as a share; five times as much on arrival


@dataclass(frozen=True)
class FailingSwingUp(PendulumSwingUp):
    name: ClassVar[str] = 'failing_swing_up'
    failure: str = parameter('crash', 'how to fail', choices=(*FAILURES, 'not'))

    def solve(self, *args: Any, **kwargs: Any) -> Solution:
        if self.failure in FAILURES:
            raise FAILURES[self.failure][0]
        return super().solve(*args, **kwargs)


@dataclass(frozen=True)
class Cart(Problem):
    """A problem that is not stated, and gets its plans from elsewhere."""

    name: ClassVar[str] = 'cart'
    start: CartStart = group(CartStart)
    limit: float = parameter(1.0, 'largest acceleration')
    solver: SolverParameters = group(SolverParameters)

    def solve(self, *args: Any, **options: Any) -> Solution:
        return DoubleIntegrator(start=self.start, limit=self.limit).solve(*args, **options)

    def search(self, *of: Any) -> Any:
        raise NotImplementedError


def start(ros: Stepped, problem: str, name: str = '', **given: Any) -> Space:
    space = Space(ros, name)
    given = {'problem': problem, 'start.source': 'parameters', **given}
    space.here = space.start('planner', given)
    return space


def test_failures_have_their_codes_and_show_in_the_diagnostics(ros):
    name = '/failing/planner: planning'
    space = start(ros, f'{__name__}:FailingSwingUp', 'failing', **{'limits.torque': 0.09})
    for failure, (_, *expected, level) in FAILURES.items():
        space.set('planner', failure=failure)
        assert [*space.refusal()] == expected
        message = ': '.join(expected)
        assert f'no plan: {message}' in space.here.output
        assert ros.says(name, message, level=level)
    space.set('planner', failure='not')
    space.plan()
    assert ros.says(name, 'plan 1 active', level=0)
    status = ros.statuses[name]
    assert status.hardware_id == '/failing/planner'
    figures = {item.key: item.value for item in status.values}
    expected = {'requests': '4', 'failures': '3', 'age of joint_states [s]': 'never received',
                'plan age [s]': '-1'}  # fmt: skip
    assert figures | expected == figures
    assert float(figures['duration [s]']) > 0.3
    assert float(figures['margin of disk_angle']) > 0
    assert figures['worst margin'].endswith(')')
    assert space.here.output.count('Traceback') == 1  # of the one that is a fault of the program
    assert space.here.output.count('raise FAILURES[') == 1
    ros.log.clear()  # or it would be taken for a crash


def test_a_problem_of_another_kind_is_served_by_names(ros):
    space = start(ros, f'{__name__}:Cart', limit=4)
    plans = space.hear('trajectory')
    answer = space.plan()
    assert answer['duration'] == pytest.approx(1.0, rel=1e-3)
    assert answer['summary'].startswith('J = 1.000')
    assert list(plans[-1].joint_names) == ['x', 'v', 'u']
    first, *_, last = plans[-1].points
    assert [*first.positions[:2]] == [-1.0, 0.0]
    assert [*last.positions[:2]] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert [first.effort[2], last.effort[2]] == pytest.approx([4.0, -4.0], abs=0.01)
    assert nanoseconds_of(last.time_from_start) == round(answer['duration'] * 1e9)
    space.set('planner', start__source='measured')
    assert space.refusal()[0] == 'NO_STATE'
    state = JointState(name=['x', 'v'], position=[-2.0, 0.0])
    space.publisher('joint_states').publish(state)
    space.plan()
    assert plans[-1].points[0].positions[0] == -2.0
    # Where there is nothing to measure, parameters say enough.
    bead = start(ros, 'brachistochrone:Brachistochrone', **{'start.source': 'measured'})
    bead.plan()
    assert 'plans begin at its stated start, whatever is measured' in bead.here.output


@dataclass(frozen=True)
class Rail(DoubleIntegrator):
    """A cart with a lamp on a rail."""

    name: ClassVar[str] = 'rail'

    def joints(self) -> Mapping[str, tuple[str, str]]:
        return {'cart': ('x', 'v')}

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        rail, box = Line(((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 'limit'), (0.4, 0.2, 0.2)
        return rail, Box((x[0], 0.0, 0.1), box), Disc((x[0], 0.0, 0.3), 0.1, trail=True)


@dataclass(frozen=True)
class Lamp(Rail):
    name: ClassVar[str] = 'lamp'
    size: float = parameter(0.1, 'radius of the lamp', unit='m')

    def drawing(self, x: Sequence[Any]) -> Sequence[Shape]:
        return (Disc((x[0], 0.0, 0.3), self.size),)


def _up_to_half(self: Rail, x: Sequence[Any]) -> Sequence[Shape]:
    if np.any(np.asarray(x[0]) > 0.5):
        raise ValueError('beyond the rail')
    return Rail.drawing(self, x)


Short = changed(Rail, name='short', drawing=_up_to_half)
Blurred = changed(Rail, name='blurred', drawing=lambda self, x: (x[7],))


class Loop(Space):
    """The three nodes of a stated problem, and the end of its plan."""

    def __init__(self, ros: Stepped, problem: str, **planner: float) -> None:
        super().__init__(ros, 'own')
        self.start('plant', {'problem': problem, 'mismatch': 0.02, 'held': True})
        self.start('tracker', {'kind': problem})
        given = {'problem': problem, 'start.source': 'parameters', **planner}
        self.planner = self.start('planner', given)
        self.states, plans = self.hear('joint_states'), self.hear('trajectory')
        self.statuses = self.hear('tracker_status', GoalStatusArray)
        self.plans = plans
        self.fly()

    def fly(self) -> None:
        self.plan()
        points = self.plans[-1].points
        ranges = np.ptp([point.positions for point in points], axis=0)
        self.ranges = np.maximum(ranges, 0.01 * ranges.max())
        self.goal = np.array(points[-1].positions)
        start, last = self.plans[-1].header.stamp, points[-1].time_from_start
        self.end = nanoseconds_of(start) + nanoseconds_of(last)

    def away(self, instant: int) -> float:
        """Return the deviation from the goal at an instant [ns], as a share."""
        assert self.ros.spin_until(lambda: self.ros.now >= instant, timeout=200.0)
        return float(np.abs((self.states[-1].position - self.goal) / self.ranges).max())


@pytest.mark.parametrize('problem', LOOPS)
def test_a_stated_plant_is_simulated_tracked_and_held(ros, problem):
    loop = Loop(ros, problem)
    assert loop.away(loop.end) < 5 * ALLOWED
    if LOOPS[problem]:
        assert loop.away(loop.end + 5 * 10**9) < ALLOWED
    ros.spin_for(0.1)
    told = [goal.status for array in loop.statuses for goal in array.status_list]
    expected = 'ACCEPTED', 'EXECUTING', 'SUCCEEDED'
    assert told == [getattr(GoalStatus, f'STATUS_{name}') for name in expected]


@pytest.mark.parametrize('problem', LOOPS)
def test_a_planner_started_again_takes_the_plan_of_a_stated_plant_back(ros, problem):
    loop = Loop(ros, problem, **{'solver.refine': False})
    plans = loop.hear('trajectory')
    assert ros.spin_until(lambda: plans)
    loop.planner.end_cleanly()
    again = loop.start('planner', {'problem': problem})
    assert ros.spin_until(lambda: 'recovered active plan 1' in again.output), again.output
    assert ros.spin_until(lambda: len(plans) == 2)
    assert plans[1] == plans[0]


def test_a_plant_falls_freely_where_its_plan_does_and_a_push_is_brought_back(ros):
    # joined late, the lander is above its plan: planned control and feedback are zero
    loop = Loop(ros, 'moon_lander:MoonLander', **{'start.delay': 0.0})
    assert loop.away(loop.end) < 5 * ALLOWED
    assert loop.away(loop.end + 5 * 10**9) < ALLOWED
    loop.trigger('push')
    loop.away(ros.now + 5 * 10**9)
    assert np.abs(loop.states[-1].position).max() < 0.1


@pytest.mark.parametrize('held', [False, True])
def test_a_plan_begins_where_a_plant_that_is_not_held_has_gone_by_then(ros, held):
    space = Space(ros, f'drifting{held}')
    space.start('plant', {'problem': f'{__name__}:Rail', 'initial.v': 2.0, 'held': held})
    space.start('tracker', {'kind': f'{__name__}:Rail'})
    space.start('planner', {'problem': f'{__name__}:Rail'})
    states, plans = space.hear('joint_states'), space.hear('trajectory')
    statuses = space.hear('tracker_status', GoalStatusArray)
    assert ros.spin_until(lambda: len(states) > 40)
    places, at = [state.position[0] for state in states[-2:]], ros.now
    space.plan()
    x, v = plans[-1].points[0].positions[0], plans[-1].points[0].velocities[0]
    ahead = (nanoseconds_of(plans[-1].header.stamp) - at) * 1e-9
    assert (x - places[-1], v) == pytest.approx((0.0 if held else 2.0 * ahead, 2.0), abs=0.02)
    followed = GoalStatus.STATUS_EXECUTING
    assert ros.spin_until(
        lambda: any(g.status == followed for array in statuses for g in array.status_list)
    )
    assert held == (places[0] == places[1])


def test_a_held_plant_that_is_reset_is_held_until_the_next_plan(ros):
    loop = Loop(ros, 'moon_lander:MoonLander')
    start = list(loop.plans[-1].points[0].positions)
    for seconds in (-1.0, 0.5):  # in flight, then held at the goal by a thrust
        assert ros.spin_until(lambda at=loop.end + seconds * 1e9: ros.now >= at, timeout=200.0)
        assert loop.states[-1].effort[-1] > 0.0
        loop.trigger('reset')
        ros.spin_for(1.5)
        assert list(loop.states[-1].position) == pytest.approx(start)
        loop.set('planner', start__source='measured')
        loop.fly()
        assert loop.plans[-1].points[0].positions == pytest.approx(start)
    assert loop.away(loop.end + 10**9) < ALLOWED


def test_a_plant_is_drawn_in_motion_and_its_plan(ros, tmp_path):
    loop = Loop(ros, f'{__name__}:Rail')
    moving, plan = loop.hear('plant_markers'), loop.hear('markers')
    assert max(loop.away(loop.end), loop.away(loop.end + 5 * 10**8)) < ALLOWED
    assert list(loop.states[-1].name) == list(loop.plans[-1].joint_names) == ['cart', 'u']
    for array in moving:
        check_markers(array, 'world', LIFETIME)
    shown = Scene(moving[-1])
    assert shown.names == {('limit', 0), ('body', 1), ('body', 2), ('trail', 2)}
    assert shown['body', 1].type == Marker.CUBE
    assert shown['body', 2].pose.position.x == pytest.approx(loop.states[-1].position[0], abs=0.05)
    check_markers(plan[-1], 'world', 0.0)
    way = Scene(plan[-1])
    assert way.names == {('planned_path', 102), ('goal', 101), ('goal', 102)}
    path = way['planned_path', 102].points
    assert (path[0].x, path[-1].x) == pytest.approx((-1.0, 0.0), abs=0.01)
    # The live page shows the first plan whole, and leaves the view to its user.
    viser = pytest.importorskip('viser')
    from tdm_sim.live.listener import Listener
    from tdm_sim.live.operations import Recordings
    from tdm_sim.live.page import Page

    listener = Listener('own', ros._context)
    ros._executor.add_node(listener.node)
    server = viser.ViserServer(host='127.0.0.1', port=0, verbose=False)
    page = Page(server, listener, Recordings(tmp_path, 'own'), 'own')

    def shown(plan_id: int) -> bool:
        page.frame()
        return page._rig.plan is not None and page._rig.plan.plan_id == plan_id

    nodes, camera = server.scene._handle_from_node_name, server.initial_camera
    assert ros.spin_until(lambda: shown(1) and '/plan/lines' in nodes)
    assert not np.allclose(camera.position, [1.0, 2.0, 3.0])
    camera.position = np.array([1.0, 2.0, 3.0])
    loop.plan()
    assert ros.spin_until(lambda: shown(2))
    assert np.allclose(camera.position, [1.0, 2.0, 3.0])
    page.close()
    server.stop()
    ros._executor.remove_node(listener.node)
    listener.close()


def test_a_real_plant_is_drawn_with_the_planners_parameters(ros):
    space = start(ros, f'{__name__}:Lamp', 'lit', size=0.25)
    shown, joints = space.hear('plant_markers'), space.publisher('joint_states')

    def measure() -> None:
        joints.publish(JointState(name=['cart'], position=[0.5], velocity=[0.0]))

    assert ros.publish_until(measure, lambda: bool(shown)), space.here.output
    (disc,) = (marker for marker in shown[-1].markers if marker.ns == 'body')
    assert (disc.pose.position.x, disc.scale.x) == (0.5, 0.5)


def test_a_drawing_that_fails_on_the_way_costs_the_picture_only(ros):
    """Of the planner and of the plant: both draw what they measure."""
    problem, told = f'{__name__}:Short', 'the plant is not drawn: drawing of Changed raises'
    real = start(ros, problem, 'short')
    shown, joints = real.hear('plant_markers'), real.publisher('joint_states')

    def draws(node: Any, place: float) -> bool:
        shown.clear()
        position = {'position': [place], 'velocity': [0.0]}
        for _ in range(20):
            joints.publish(JointState(name=['cart'], **position))
            ros.spin_for(0.01)
        return any(array.markers for array in shown)

    assert [draws(real.here, place) for place in (0.4, 0.6, 0.7, 0.3)] == [
        True,
        False,
        False,
        True,
    ]
    assert real.here.output.count(told) == 1
    real.here.end_cleanly()
    plant = Space(ros, 'shorter').start('plant', {'problem': problem, 'initial.v': 2.0})
    moving = ros.subscribe('/shorter/plant_markers')
    ros.spin_for(0.4)
    assert any(array.markers for array in moving)
    ros.spin_for(2.0)
    assert ros.silent(moving)
    assert plant.output.count(told) == 1
    plant.end_cleanly()


def test_a_joint_without_a_velocity_tells_the_rate_of_its_position(ros):
    space = Space(ros, 'rated')
    space.start('plant', {'problem': 'double_integrator:DoubleIntegrator', 'held': True})
    states, commands = space.hear('joint_states'), space.publisher('joint_command')
    assert ros.spin_until(lambda: states)
    assert not any(states[-1].velocity)
    commands.publish(JointState(name=['u'], effort=[0.5]))
    assert ros.spin_until(lambda: states[-1].effort[2] == 0.5)
    told = states[-1]
    assert list(told.velocity) == [told.position[1], 0.5, 0.0]


def test_a_plant_has_an_initial_value_and_noise_of_every_state(ros):
    space = Space(ros, 'begun')
    given = {'initial.x': 0.5, 'noise.v': 0.1}
    space.start('plant', {'problem': f'{__name__}:Rail', **given})
    states = space.hear('joint_states')
    assert ros.spin_until(lambda: len(states) > 300)
    positions, rates = np.array([[s.position[0], s.velocity[0]] for s in states]).T
    assert set(positions) == {0.5}
    assert (rates.mean(), rates.std()) == pytest.approx((0.0, 0.1), abs=0.02)
    space.set('plant', initial__x=None)
    space.trigger('reset')
    assert ros.spin_until(lambda: states[-1].position[0] == -1.0)


@dataclass(frozen=True)
class Kind(Rail):
    """A parameter has the name of one of the tracker's own."""

    name: ClassVar[str] = 'kind'
    kind: float = parameter(1.0, 'whatever')


@pytest.mark.parametrize(
    ('node', 'problem', 'says'),
    [
        ('plant', 'crane', "'problem' = 'crane' is not allowed"),
        ('plant', f'{__name__}:Blurred', 'drawing of Changed raises IndexError'),
        ('planner', 'pendulum_swingup',
         'such as my_module:MyProblem (did you mean pendulum_swing_up or pendulum?)'),
        ('tracker', 'crane', "'kind' = 'crane' is not allowed: must be one of pendulum"),
        ('tracker', '3', "'kind' = 3 is not allowed: must be a string"),
        ('tracker', f'{__name__}:Kind', "parameter 'kind' of Kind is one of the nodes' own"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_simulated_or_tracked_ends_the_node(ros, node, problem, says):
    name = 'kind' if node == 'tracker' else 'problem'
    with pytest.raises(InvalidProblem) as raised:
        ros.start(node, {name: problem}, 'fatal')
    assert says in str(raised.value)
