# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plant, tracker or planner killed, and started again: what goes on, falls safe, recovers.

Each function does it to a `PendulumRig` of processes that is held upright, and returns figures in
s; used once in test/system/test_ended.py, over and over in test/nightly/faults. Time waits for
plant and tracker while they live: a busy machine makes a scenario longer, and no other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import json

from pendulum_rig import PendulumRig
from ros_harness import Ros
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import seconds_of
from trajectory_msgs.msg import JointTrajectory


def held_rig(ros: Ros) -> PendulumRig:
    """Return a pendulum that is held upright, and planned for anew where it is not."""
    ros.drive_clock('/faults/joint_states', '/faults/joint_command')
    rig = PendulumRig(ros, 'faults', common={'use_sim_time': True}, planner={'replan.rate': 5.0})
    rig.held_since(rig.plan()[0])
    return rig


def plant_killed(rig: PendulumRig, moment: str = 'holding') -> dict[str, float]:
    """Nothing is commanded without a state."""
    if moment == 'tracking':
        rig.fall()
    rig.wait(lambda: rig.says('tracker', moment))
    newest = rig.kill('pendulum_plant')
    rig.wait(lambda: rig.says('tracker', 'older than state_timeout'))
    rig.wait(lambda: rig.commands[-1].effort[0] == 0.0)

    def last_command() -> float:
        last = next(c for c in reversed(rig.commands) if c.effort[0] != 0.0)
        return seconds_of(last.header.stamp)

    safe = last_command() - newest
    seen = len(rig.states)
    rig.start('pendulum_plant')
    rig.wait(lambda: len(rig.states) > seen)
    back = seconds_of(rig.states[seen].header.stamp)
    assert last_command() < back
    return {'safe': safe, 'recovered': rig.held_since(back) - back}


def tracker_killed(rig: PendulumRig) -> dict[str, float]:
    """
    In mid-swing: the plant's torque goes off by itself.

    Without friction the disk then turns on, beyond its limit if a tracker starts late, and no plan
    leads back from there: somebody takes the pendulum down before the tracker starts again.
    """
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking'))
    killed = rig.kill('tracker')
    rig.wait(lambda: rig.now > killed + 1.0)
    rig.wait(lambda: rig.states[-1].effort[1] == 0.0)
    safe = rig.last_torque(killed)
    rig.ros.call(f'/{rig.namespace}/reset', Trigger)
    restarted = rig.ros.seconds
    rig.start('tracker')
    return {'safe': safe, 'recovered': rig.held_since(restarted) - restarted}


def planner_killed(rig: PendulumRig) -> dict[str, float]:
    """While it plans: all goes on, and the active plan comes back as it was."""
    ros, space = rig.ros, f'/{rig.namespace}'
    rig.fall()
    rig.wait(lambda: rig.says('tracker', 'tracking') or rig.says('tracker', 'waiting'))
    ros.request(f'{space}/plan', Trigger)
    rig.wait(lambda: rig.says('planner', 'planning'))
    held = rig.held_since(rig.kill('planner'))

    def told() -> list[float]:
        names = 'trajectories accepted', 'trajectories rejected'
        return [rig.figure('tracker', name) for name in names]

    before, plan = told(), rig.followed[-1]
    rig.plans.clear()
    restarted = ros.seconds
    rig.start('planner')
    rig.wait(lambda: rig.plans)
    back = ros.seconds
    rig.wait(lambda: rig.says('planner', 'plan 1 active') or rig.says('planner', 'publish'))
    late = ros.subscribe(f'{space}/trajectory', JointTrajectory, LATCHED)
    summaries = ros.subscribe(f'{space}/plan_summary', String, LATCHED)
    rig.wait(lambda: late and summaries)
    starts = [[seconds_of(p.header.stamp) for p in plans] for plans in (late, rig.followed)]
    assert late[-1].header.stamp == plan.header.stamp, f'{starts}\n{rig.story()}'
    assert [p.positions for p in late[-1].points] == [p.positions for p in plan.points]
    assert [p.effort for p in late[-1].points] == [p.effort for p in plan.points]
    assert json.loads(summaries[-1].data)['verification']['ok']
    known = len(rig.statuses('tracker'))
    rig.wait(lambda: len(rig.statuses('tracker')) > known + 1)
    assert told() == before
    assert rig.lean(held + 0.5) < 0.2
    done, answer = ros.trigger(f'{space}/plan')
    assert done or answer['code'] == 'BUSY', answer
    return {'safe': 0.0, 'recovered': back - restarted}


SCENARIOS: dict[str, Callable[[PendulumRig], dict[str, float]]] = {
    'plant killed while holding': plant_killed,
    'plant killed in mid-swing': partial(plant_killed, moment='tracking'),
    'tracker killed in mid-swing': tracker_killed,
    'planner killed while planning': planner_killed,
}
