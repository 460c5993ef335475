# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans that others come before or that are refused: over DDS, plant and tracker running."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.nodes.messages import joint_motion, PENDULUM_JOINTS

WEAK = {'limits.torque': 0.02}
# Deadlines of up to half the delay do not change which start is waited for.
PLANNING = {'solver.deadline': 1.0, 'start.delay': 2.0, 'start.max_age': 5.0}


class Rig:
    """A pendulum that hangs at rest, its tracker and its planner."""

    def __init__(self, ros: Ros, namespace: str) -> None:
        self.ros, self.namespace = ros, namespace
        self.plant = self.start('tdm_sim.pendulum_plant', {})
        self.tracker = self.start('tdm_planner.nodes.tracker', {})
        self.planner = self.start('tdm_planner.nodes.planner', PLANNING)
        self.states = ros.subscribe(f'/{namespace}/joint_states', JointState)

    def start(self, module: str, parameters: dict[str, Any]) -> NodeProcess:
        return self.ros.start(module, {**WEAK, **parameters}, namespace=self.namespace)

    def swing_up(self) -> None:
        """Plan until it is held: a pause of the machine in mid-swing costs a catch."""
        for _ in range(4):
            self.ros.call(f'/{self.namespace}/reset', Trigger)
            done, answer = self.ros.trigger(f'/{self.namespace}/plan')
            assert done, answer
            if self.ros.spin_until(lambda: len(self.states) > 1000 and self.upright, 10.0):
                return
            self.states.clear()
        raise AssertionError(self.tracker.output)

    @property
    def upright(self) -> bool:
        motions = [joint_motion(state, PENDULUM_JOINTS) for state in self.states[-100:]]
        return all(abs(math.remainder(float(motion[0]), math.tau)) < 0.1 for motion in motions)


# The first plan begins two seconds after its request; the last request waits for it to begin.
@pytest.mark.parametrize('pauses', [(0.4,), (0.9,), (1.5,), (0.2, 0.6, 0.6)], ids=str)
def test_the_last_of_several_requests_is_followed(ros: Ros, pauses: tuple[float, ...]) -> None:
    rig = Rig(ros, 'second_' + '_'.join(str(round(100 * pause)) for pause in pauses))
    assert ros.spin_until(lambda: bool(rig.states), 20.0)
    for pause in (*pauses, 0.0):
        done, answer = ros.trigger(f'/{rig.namespace}/plan')
        assert done, answer
        ros.spin_for(pause)
    assert ros.spin_until(lambda: rig.upright, 10.0), rig.tracker.output
    # Made in the middle of a swing a plan may be refused, and the one before be carried on.
    assert len(pauses) > 1 or pauses[0] > 0.6 or 'refused' not in rig.tracker.output
    assert 'stopped' not in rig.tracker.output
    for process in (rig.planner, rig.tracker, rig.plant):
        process.end_cleanly()


def test_a_plan_that_is_refused_is_told_of_by_the_planner_too(ros: Ros) -> None:
    """Upright, the tracker is offered a swing-up from hanging; nothing reviews it."""
    rig = Rig(ros, 'refusing')
    diagnostics = ros.subscribe('/diagnostics', DiagnosticArray, 50)
    assert ros.spin_until(lambda: bool(rig.states), 20.0)
    rig.swing_up()
    ros.set_parameters('/refusing/planner', start__source='parameters')
    done, answer = ros.trigger('/refusing/plan')
    assert done, answer
    sentence = f'plan {answer["plan_id"]} is not followed by pendulum: the tracker says why'
    assert sentence not in rig.planner.output
    assert ros.spin_until(lambda: sentence in rig.planner.output, 5.0), rig.planner.output
    assert 'trajectory refused' in rig.tracker.output

    def told() -> bool:
        found = [
            s for a in diagnostics for s in a.status if s.name.startswith('/refusing/planner')
        ]
        return bool(found) and sentence in found[-1].message

    assert ros.spin_until(told)
    for process in (rig.planner, rig.tracker, rig.plant):
        process.end_cleanly()
