# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Faults of data: streams of states that are spoiled, clocks that are set, while a pendulum moves.

`FAULTS` assert what docs/reliability.md promises, and return what was measured, on `misled_rig`.
"""

from collections.abc import Callable
import copy
from functools import partial
import heapq
import itertools
import random
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from pendulum_rig import COMMAND_TIMEOUT, PendulumRig, STATE_TIMEOUT
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
from tdm_planner.nodes.messages import to_stamp
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.trajectory import SECOND

SHORTEST_SWING = 0.3  # s, less than any swing-up takes
SILENCE = 0.6  # s
LATER = 0.01  # s between an event and the next state and command
SAFE = STATE_TIMEOUT + COMMAND_TIMEOUT + LATER  # s within which the torque is off, at the latest
STUCK_SAFE = SAFE + 3 * STATE_TIMEOUT
MOST_LEAN = 0.35  # rad from upright, shortly after the catch
HELD_LEAN = 0.15  # rad, while being held

Figures = dict[str, float]


class Relay:
    """
    Passes states on from the plant to all others, and spoils them; chance is seeded.

    - freeze: nothing comes; drop: each is lost with the probability `amount`;
    - repeat: the last message before comes again and again; stuck: the same with fresh stamps;
    - delay: they come `amount` s late; reorder: each up to `amount` s late;
    - duplicate: each comes twice, the second time up to `amount` s later;
    - shift: their stamps are wrong by `amount` s, from the least instant that can be written on;
    - unstamped: their stamps are zero.
    """

    def __init__(self, ros: Stepped, source: str, target: str) -> None:
        self._ros, self._last, self._order = ros, JointState(), itertools.count()
        self._held: list[tuple[float, int, JointState]] = []
        self._publisher = ros.node.create_publisher(JointState, target, 200)
        ros.node.create_subscription(JointState, source, self._on_state, 200)
        self.suffer()

    def suffer(self, kind: str = 'none', amount: float = 0.0) -> None:
        self._kind, self._amount, self._random = kind, amount, random.Random(7)

    def _on_state(self, message: JointState) -> None:
        now = self._ros.now / SECOND
        for delay, state in self._spoilt(message):
            heapq.heappush(self._held, (now + delay, next(self._order), state))
        while self._held and self._held[0][0] <= now:
            self._publisher.publish(heapq.heappop(self._held)[2])

    def _spoilt(self, message: JointState) -> list[tuple[float, JointState]]:
        """Return what becomes of a message: those that come, each with its delay [s]."""
        kind, amount, stamp = self._kind, self._amount, message.header.stamp
        chance = self._random.random()
        if kind not in ('repeat', 'stuck'):
            self._last = message
        passed = copy.deepcopy(self._last)
        if kind == 'shift':
            shifted = nanoseconds_of(stamp) + round(amount * SECOND)
            stamp = to_stamp(max(shifted, -(2**31) * SECOND))
        if kind != 'repeat':
            passed.header.stamp = Time() if kind == 'unstamped' else stamp
        delays = {'freeze': [], 'drop': [0.0] * (chance >= amount), 'delay': [amount],
                  'duplicate': [0.0, chance * amount], 'reorder': [chance * amount]}  # fmt: skip
        return [(delay, passed) for delay in delays.get(kind, [0.0])]


class MisledRig(PendulumRig):
    """A rig whose planner and tracker see states as `relay` passes them on."""

    ros: Stepped
    plant_arguments: ClassVar[list[str]] = ['-r', 'joint_states:=unspoilt']

    def __init__(self, stepped: Stepped, namespace: str, **common: Any) -> None:
        self.relay = Relay(stepped, f'/{namespace}/unspoilt', f'/{namespace}/joint_states')
        super().__init__(stepped, namespace, common, planner={'start.delay': 0.1})
        self.states = self.hear('unspoilt', JointState)
        self.wait(lambda: self.states)

    @property
    def is_held(self) -> bool:
        return abs(self.angle) < HELD_LEAN and self.says('tracker', 'holding')

    def begin(self) -> tuple[float, float]:
        """Let a swing-up from hanging begin; return the instants of `plan`."""
        self.relay.suffer()
        self.trigger('reset')
        resting = ('idle', 'stopped', 'recovering')
        self.wait(lambda: any(self.says('tracker', word) for word in resting))
        del self.states[:-1]
        for _ in range(5):  # a plan made before it hung leads elsewhere
            start, end = self.plan()
            if end - start > SHORTEST_SWING:
                return start, end
            self.wait_until(self.now + 0.02)
        raise AssertionError(self.story())

    def reach(self, phase: str) -> float:
        """Begin a mission; return the instant [s] in mid-swing, or after half a second's hold."""
        start, end = self.begin()
        self.wait_until(0.5 * (start + end) if phase == 'swing' else end + 0.5)
        if phase == 'hold':
            self.wait(lambda: self.is_held)
        return self.now


def harmless(rig: MisledRig, kind: str, amount: float) -> Figures:
    """From mid-swing on: the motion and the hold go on."""
    start, end = rig.begin()
    rig.wait_until(0.5 * (start + end))
    rig.relay.suffer(kind, amount)
    rig.wait_until(end + 2.0)
    found = {'caught': rig.lean(end + 0.3, end + 0.8), 'held': rig.lean(end + 0.8)}
    assert rig.is_held, rig.story()
    assert found['caught'] < MOST_LEAN, found
    assert found['held'] < HELD_LEAN, found
    return found


def silent(rig: MisledRig, kind: str, phase: str, amount: float = 0.0) -> Figures:
    """Withhold states: it is noticed, the torque goes off in time, the mission is completed."""
    stuck = kind == 'stuck'
    at = rig.reach(phase)
    end = at + (1.5 if stuck else SILENCE)
    rig.relay.suffer(kind, amount)
    if stuck:
        rig.wait(lambda: rig.says('tracker', 'is a sensor stuck?'))
    rig.wait_until(end)
    rig.relay.suffer()
    safe = rig.last_torque(at, end)
    assert safe < (STUCK_SAFE if stuck else SAFE), rig.story()
    recovered = rig.held_since(end) - end
    assert stuck or rig.said('tracker', 'state_timeout') or 'state_timeout' in rig.story()
    return {'safe': safe, 'recovered': recovered}


def largest_delay(rig: MisledRig, delay: float, falls: bool) -> Figures:
    """While holding, with a `state_timeout` that does not end it."""
    rig.set('tracker', state_timeout=1.0)
    at = rig.reach('hold')
    rig.relay.suffer('delay', delay)
    rig.wait_until(at + 4.0)
    rig.set('tracker', state_timeout=STATE_TIMEOUT)
    held = rig.lean(at)
    assert (held > 0.5) == falls, held
    return {'held': held}


def time_of_day_set(rig: MisledRig, step: float, phase: str) -> Figures:
    """Set it for nodes without `use_sim_time`: timers fire, states are fresh."""
    at = rig.reach(phase)
    rig.ros.time_of_day += step
    known = len(rig.states)
    rig.ros.spin_for(2.0)
    assert abs(rig.now - at - step - 2.0) < LATER
    del rig.states[: known + 100]
    assert rig.says('tracker', 'holding'), rig.story()
    assert 'the clock was set by' in rig.processes['tracker'].output
    assert 'the process was stalled' not in rig.processes['pendulum_plant'].output
    found = {'lean': rig.lean()}
    assert found['lean'] < MOST_LEAN
    return found


def simulated_time_set(rig: MisledRig, step: float) -> Figures:
    """Set back, the motion is given up, and the next one is as good as any."""
    rig.reach('hold')
    rig.ros.leap(step)
    del rig.states[:]
    rig.ros.spin_for(LATER)
    at = rig.now
    rig.wait_until(at + 1.0)
    if step > 0.0:
        assert rig.is_held, rig.story()
        return {'lean': rig.lean(at)}
    assert 'the clock was set back' in rig.processes['tracker'].output
    safe = rig.last_torque(at)
    assert safe < 2 * LATER
    rig.reach('hold')
    return {'safe': safe}


def negative_simulated_times(rig: MisledRig) -> Figures:
    at = rig.reach('hold')
    node = rig.ros.node  # as rclpy made it: it must not hear this clock itself
    node.set_parameters([Parameter('use_sim_time', value=False)])
    clock = node.create_publisher(Clock, '/clock', 1)
    for base in (-5, -(2**31), -5):
        clock.publish(Clock(clock=Time(sec=base, nanosec=1)))
        rig.ros.spin_for(0.1)
    node.destroy_publisher(clock)
    node.set_parameters([Parameter('use_sim_time', value=True)])
    rig.wait_until(at + 1.0)
    assert 'must not be negative' in rig.processes['tracker'].output
    assert rig.is_held, rig.story()
    return {'lean': rig.lean(at)}


HARMLESS = [('delay', 0.05), ('delay', 0.07), ('drop', 0.05), ('drop', 0.5), ('duplicate', 0.03),
            ('reorder', 0.03), ('unstamped', 0.0)]  # fmt: skip
SILENT = [('freeze', 0.0), ('shift', 5.0), ('shift', -5.0), ('repeat', 0.0), ('shift', -2e9)]
PHASES = ('swing', 'hold')
QUICK = 'delay 0.07', 'stuck in hold', 'simulated time -5 s', 'time of day -5 s in swing'
TIME_OF_DAY = 'time of day'  # at the beginning of the names of faults for nodes that go by it
FAULTS: dict[str, Callable[[MisledRig], Figures]] = {
    **{f'{kind} {much:g}': partial(harmless, kind=kind, amount=much) for kind, much in HARMLESS},
    **{f'{kind} {much:g} in {phase}': partial(silent, kind=kind, amount=much, phase=phase)
       for kind, much in SILENT for phase in PHASES},
    **{f'stuck in {phase}': partial(silent, kind='stuck', phase=phase) for phase in PHASES},
    'delay 0.2 with state_timeout 1 s': partial(largest_delay, delay=0.2, falls=False),
    'delay 0.3 with state_timeout 1 s': partial(largest_delay, delay=0.3, falls=True),
    **{f'simulated time {step:+g} s': partial(simulated_time_set, step=step) for step in (5, -5)},
    'negative simulated times': negative_simulated_times,
    **{f'{TIME_OF_DAY} {step:+g} s in {phase}': partial(time_of_day_set, step=step, phase=phase)
       for step in (5, -5) for phase in PHASES},
}  # fmt: skip


def misled_rig(stepped: Any, fault: str) -> MisledRig:
    """Return a rig for some of the faults, made once in a domain."""
    space = 'day' if fault.startswith(TIME_OF_DAY) else 'misled'
    rigs = vars(stepped).setdefault('misled_rigs', {})
    if space not in rigs:
        common = {'use_sim_time': False} if space == 'day' else {}
        rigs[space] = MisledRig(stepped, space, **common)
    return rigs[space]
