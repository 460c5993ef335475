# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A stated plant is judged by its own end conditions and limits, in a recording like any other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from double_integrator import DoubleIntegrator
import numpy as np
from recordings import recorded, write
from tdm_planner.direct_method import Duration, Output
from tdm_planner.drawing import Disc
from tdm_planner.parameters import parameter, POSITIVE
from tdm_planner.plant_views import StatedView
from tdm_planner.problems import DirectProblem
from tdm_planner.trajectory import Trajectory
from tdm_sim.report.animation import scene
from tdm_sim.report.mission import FollowedPlan, Mission, Signals, Vehicle
from tdm_sim.report.reader import read_mission
from tdm_sim.report.verdict import held_from, judge, Verdict, verdict

LENGTH = 2.0  # s


@dataclass(frozen=True)
class Sled(DoubleIntegrator):
    """A sled that goes 1 m, to rest or past the mark."""

    name: ClassVar[str] = 'sled'
    limit: float = parameter(2.0, 'largest acceleration', unit='m/s^2', allowed=POSITIVE)

    margins, final_cost = DirectProblem.margins, DirectProblem.final_cost

    def outputs(self) -> Any:
        return {'x': Output(start=(0.0, 0.0), end=(1.0, 0.0))}

    def duration(self) -> Duration:
        return Duration(guess=LENGTH)

    def control_limits(self) -> Any:
        return {'u': (-self.limit, self.limit)}

    def joints(self) -> Any:
        return {'runner': ('x', 'v')}

    def drawing(self, x: Any) -> Any:
        return [Disc((x[0], 0.0), 0.1, trail=True)]


class Passing(Sled):
    """Its velocity at the mark is free, but for a condition."""

    name = 'passing'

    def outputs(self) -> Any:
        return {'x': Output(start=(0.0, 0.0), end=(1.0,))}

    def end_conditions(self, t: Any, x: Any) -> Any:
        return (x[1] - 1.5,)


def plan(end: float) -> Trajectory:
    """From rest to 1 m, where the velocity is `end`: a cubic."""
    t = np.linspace(0.0, LENGTH, 81)
    b, a = 3 / LENGTH**2 - end / LENGTH, end / LENGTH**2 - 2 / LENGTH**3
    states = np.stack([b * t**2 + a * t**3, 2 * b * t + 3 * a * t**2], axis=1)
    controls, units = (2 * b + 6 * a * t)[:, None], ('m', 'm/s')
    return Trajectory(t, states, controls, ('x', 'v'), ('u',), 'linear', units, ('m/s^2',))


def mission(problem: DirectProblem, end: float, until: float = 9.0, **off: float) -> Mission:
    """Return a mission that follows the plan, off by so much in the states and the control."""
    motion = plan(end)
    at = np.arange(0.0, until, 0.01)
    states, controls = motion.sample(np.minimum(at, LENGTH))
    states = states + np.array([off.get('x', 0.0), off.get('v', 0.0)])
    controls = (at[:, None] < LENGTH) * controls + off.get('u', 0.0)
    vehicle = Vehicle(
        'sled',
        StatedView(problem),
        (FollowedPlan(motion, 0.0),),
        states=Signals(at, states, ('x', 'v'), ('m', 'm/s')),
        commands=Signals(at, controls, ('u',), ('m/s^2',)),
    )
    return Mission('Sled', problem.name, (vehicle,))


def judged(problem: DirectProblem, end: float, **changes: Any) -> Verdict:
    found = judge(mission(problem, end, **changes))
    assert found is not None
    return found


def test_a_goal_that_can_be_held_must_be() -> None:
    good = judged(Sled(), 0.0)
    assert good.reached, good
    assert '5 s or more: x within 0.05 m; v within' in good.criterion
    (reason,) = judged(Sled(), 0.0, x=0.06).reasons
    assert reason == 'sled was not at its goal within 1 s of the planned end: off in x by 0.06 m'
    assert judged(Sled(), 0.0, until=6.5).undecided.startswith('the recording ends at 6.5 s')


def test_of_a_motion_that_is_not_held_its_end_counts_where_it_is_stated() -> None:
    """What is free is not judged, what comes afterwards neither."""
    assert judged(Passing(), 1.5).reached
    assert judged(Passing(), 1.5, v=0.02).reached
    assert 'off in x by 0.1 m' in judged(Passing(), 1.5, x=0.1).reasons[0]
    assert 'end condition 0' in judged(Passing(), 1.5, v=0.2).reasons[0]
    assert judged(Passing(), 1.5, until=1.5).undecided


def test_limits_leave_the_feedback_some_room() -> None:
    assert judged(Sled(), 0.0, u=0.55).reached  # 2.5 % above 2 m/s^2
    (reason,) = judged(Sled(), 0.0, u=0.7).reasons
    assert "violated the limit 'u, highest' by 0.0" in reason


def test_a_recording_of_it_is_judged_where_the_class_is_given(tmp_path: Path) -> None:
    sled = replace(mission(Sled(), 0.0), parameters={'limit': 2.0})
    bag = write(tmp_path / 'bag', recorded(sled, '/sled'))
    found = verdict(bag, problem=Sled)
    assert found is not None
    assert found.reached, found
    drawn = scene(read_mission(bag, problem=Sled))
    assert drawn is not None
    assert [shape['kind'] for shape in drawn['vehicles'][0]['measured']] == ['disc']
    # what a recording names is not imported
    assert verdict(bag) is None
    assert any("'sled' is not installed" in text for text in read_mission(bag).missing)


def test_held_from_the_last_time_outside() -> None:
    times = np.arange(5.0)
    assert held_from(times, np.array([2, 0, 2, 0, 0.0])) == 3.0
    assert held_from(times, np.array([0, 0, 0, 0, 2.0])) == np.inf
    assert held_from(times, np.array([np.nan, 0, 0, 0, 0])) == 1.0
    assert held_from(times, np.zeros(5)) == 0.0
