# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The demo of any stated problem: to its end, held for five seconds where it can be held."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.nodes.messages import LATCHED, seconds_of
from tdm_planner.nodes.reading import read_command, read_plan, read_state
from tdm_planner.nodes.stated_plants import stated_problem
from tdm_planner.plan_files import finite
from tdm_planner.plan_margins import plan_margins
from tdm_planner.plant_kind import kind_of
from tdm_planner.plotting import Measurement, plot_trajectory
from tdm_planner.problems.direct_plant import TracedPlant
from tdm_planner.problems.direct_statement import constraints_of
from tdm_planner.tracking.stated_tracking import StatedTracker
from tdm_planner.tracking.tracker_parameters import TrackerParameters
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import usual_tolerance, verify
from tdm_sim.demo_scene import NodeCommand, Scene
from tdm_sim.verdict import ends_early, HOLD_TIME, Verdict
from trajectory_msgs.msg import JointTrajectory

Array = NDArray[np.float64]

ALLOWED = 0.05  # deviation from the end, as a share of what the states run through
_FIRST = 0.05  # s after the start, until when the command before it may be in force
_OVERSHOT = 0.05  # by which a limit, as a share, may be violated: feedback needs room, too


class StatedScene(Scene):
    """Planner, tracker and plant of a problem in a namespace of its name."""

    longest = 120.0

    def __init__(self, parameters: Mapping[str, Any], file: Path, problem: str) -> None:
        super().__init__(parameters, file)
        self.given_name = problem
        self.problem = stated_problem(problem).from_parameters(self.parameters)
        self.namespace = f'/{self.problem.name}'
        self._kind = kind_of(self.problem)
        self._tracker = StatedTracker(self.problem, TrackerParameters())
        self.clear()

    def clear(self) -> None:
        """Forget what was measured and planned: another mission begins."""
        self.trajectory: Trajectory | None = None
        self.starts_at, self._held = math.inf, False
        self._states: list[tuple[float, Array]] = []
        self._commands: list[tuple[float, Array]] = []

    @property
    def plants(self) -> tuple[str, ...]:
        """Return the one plant's namespace."""
        return (self.namespace,)

    def nodes(self) -> list[NodeCommand]:
        """Plant, tracker, planner."""
        made = []
        for name, module, parameter, drives in (
            ('plant', 'tdm_sim.stated_plant', 'problem', True),
            ('tracker', 'tdm_planner.nodes.tracker', 'kind', False),
            ('planner', 'tdm_planner.nodes.planner', 'problem', False),
        ):
            _, module, arguments = self.command(name, module, self.namespace, drives)
            made.append((name, module, [*arguments, '-p', f'{parameter}:={self.given_name}']))
        return made

    def listen(self, node: Node) -> None:
        """Subscribe to states, commands and plans."""
        super().listen(node)
        node.create_subscription(
            JointState, 'joint_states', self._measured, qos_profile_sensor_data
        )
        node.create_subscription(
            JointState, 'joint_command', self._commanded, qos_profile_sensor_data
        )
        node.create_subscription(JointTrajectory, 'trajectory', self._planned, LATCHED)

    def _measured(self, message: JointState) -> None:
        at = seconds_of(message.header.stamp)
        self._states.append((at, read_state(self._kind, message)))

    def _commanded(self, message: JointState) -> None:
        control = read_command(self._kind, message)
        self._commands.append((seconds_of(message.header.stamp), control))

    def _planned(self, message: JointTrajectory) -> None:
        self.trajectory = read_plan(self._kind, message)
        self.starts_at = seconds_of(message.header.stamp)
        self._held = self._tracker.prepare(self.trajectory).end is not None

    def unconnected(self) -> list[str]:
        """Name plant and tracker where they are not up and connected."""
        plant, tracker = f'{self.namespace}/plant', f'{self.namespace}/tracker'
        up = {
            'plant': bool(self._states) and self.connections.plant(plant),
            'tracker': self.connections.tracker(tracker),
        }
        return [name for name, there in up.items() if not there]

    @property
    def planned(self) -> bool:
        """Whether the trajectory has been received."""
        return self.trajectory is not None

    @property
    def _until(self) -> float:
        """Time from the start of the motion to the end of what is judged [s]."""
        assert self.trajectory is not None
        return self.trajectory.duration + (HOLD_TIME if self._held else 0.0)

    @property
    def over(self) -> bool:
        """Whether the end has come, and has been held."""
        if self.trajectory is None or not self._states:
            return False
        return self._states[-1][0] > self.starts_at + self._until + 0.2

    def status(self) -> str:
        """Return time and states."""
        if not self._states:
            return 'waiting for the plant'
        at, state = self._states[-1]
        clock = f't = {at - self.starts_at:+6.2f} s   ' if self.planned else ''
        values = zip(self._kind.state_names, state.tolist(), strict=True)
        return clock + '   '.join(f'{name} {value:+.3g}' for name, value in values)

    def _histories(self) -> tuple[Array, Array, Array]:
        """Return times (n,) from the start, measured states (n, nx), commands (n, nu) then."""
        times = np.array([at for at, _ in self._states]) - self.starts_at
        states = np.array([state for _, state in self._states])
        sent = np.array([at for at, _ in self._commands]) - self.starts_at
        commands = np.array([control for _, control in self._commands])
        during = (times > -0.2) & (times < self._until + 0.2)
        index = np.clip(np.searchsorted(sent, times[during], side='right') - 1, 0, sent.size - 1)
        return times[during], states[during], commands[index]

    def judge(self) -> Verdict:
        """Judge the end, how it was held, and the limits on the way."""
        plan = self.trajectory
        assert plan is not None
        times, states, controls = self._histories()
        away = np.abs(states - plan.states[-1]) / self._tracker.ranges
        landing = int(np.argmin(np.abs(times - plan.duration)))
        after = (times >= plan.duration) & (times <= self._until)
        last = away[-1] if self._held else away[landing]
        reasons = [
            f"'{name}' ended {value:.3g} of its range from the goal (allowed {ALLOWED:g})"
            for name, value in zip(plan.state_names, last.tolist(), strict=True)
            if not value < ALLOWED
        ]
        moving = (times >= _FIRST) & (times <= plan.duration)
        stated = CheckedFormulation(self.problem)
        margins = stated.margins(times[moving], states[moving], controls[moving])
        planned = stated.margins(plan.times, plan.states, plan.controls)
        rows = [
            ('duration of the plan [s]', f'{plan.duration:.3f}', ''),
            ('J', f'{float(self.answer["cost"]):.6g}', ''),
            (
                'largest deviation at the end, share of the range',
                '0',
                f'{away[landing].max():.4f}',
            ),
        ]
        if self._held:
            rows.append(('worst while held', f'< {ALLOWED:g}', f'{away[after].max():.4f}'))
        for name, values in margins.items():
            least = float(values.min())
            rows.append((f'least margin, {name}', f'{planned[name].min():.4f}', f'{least:.4f}'))
            if least < -_OVERSHOT:
                reasons.append(
                    f"the limit '{name}' was violated by {-least:.3g}: a `reserve` in the "
                    'statement leaves a share of it to the feedback'
                )
        rows.append(('time to solve [ms]', f'{1e3 * float(self.answer["solve_time"]):.0f}', ''))
        early = times[-1] < self._until - 0.1
        undecided = ends_early(float(times[-1])) if early and not reasons else ''
        return Verdict(tuple(reasons), tuple(rows), undecided)

    def plan(self) -> dict[str, Any]:
        """Return the published trajectory and the planner's figures, replayed and checked here."""
        plan = self.trajectory
        assert plan is not None
        check = verify(
            TracedPlant(self.problem),
            plan,
            plan.states[-1],
            usual_tolerance(plan.states, self.problem.state_units),
            constraints_of(CheckedFormulation(self.problem), plan),
        )
        return {
            **self.figures(self.problem.name),
            **plan.to_dict(),
            'verification': check.to_dict(),
            'summary': str(self.answer['summary']),
            'parameters': finite(self.problem.to_parameters()),
        }

    def draw(self, path: Path) -> None:
        """Draw planned and measured time histories."""
        plan = self.trajectory
        assert plan is not None
        times, states, controls = self._histories()
        columns = dict(zip(plan.state_names, states.T, strict=True))
        columns |= dict(zip(plan.control_names, controls.T, strict=True))
        figure = plot_trajectory(
            plan,
            {},
            Measurement(times, columns),
            str(self.answer['summary']),
            plan_margins(self.problem, plan),
        )
        figure.savefig(path, dpi=110)
