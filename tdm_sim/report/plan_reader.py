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

"""A mission out of a plan file: what is to be done, without anything measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plan_files import load_plan, vehicles
from tdm_planner.plant_kind import PENDULUM, ROBOT
from tdm_planner.trajectory import Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.mission import Mission, PlanFigures, PlanInForce, Plant, Vehicle
from tdm_sim.report.plan_documents import plan_figures

_TITLES = {
    'pendulum_swing_up': 'Plan of a swing-up of the rotary pendulum',
    'robot_formation': 'Plan of a formation of floating robots',
}


def read_plan(path: Path) -> Mission:
    """
    Read a plan file of `tdm plan` or of a demo.

    Raises
    ------
    InvalidProblem
        If the file cannot be read or is not a plan.

    """
    try:
        document = load_plan(path)
        trajectories = {
            untrusted.text(name, 60): Trajectory.from_dict(dict(part))
            for name, part in vehicles(document).items()
        }
    except (TypeError, ValueError, AttributeError, KeyError, RecursionError):
        raise InvalidProblem(f"the file '{path}' is not a plan written by tdm") from None
    problem = untrusted.text(document['problem'], 100)
    figures = plan_figures(document, 0.0)
    return Mission(
        title=_TITLES.get(problem, f'Plan for {problem}'),
        problem=problem,
        vehicles=tuple(_vehicle(name, motion) for name, motion in trajectories.items()),
        figures=(figures,),
        parameters=figures.parameters,
        missing=_missing(document, figures),
        source=str(path),
    )


def _vehicle(name: str, trajectory: Trajectory) -> Vehicle:
    plant = _plant(trajectory)
    plan = PlanInForce(plan_id='', start=-float(trajectory.times[0]), trajectory=trajectory)
    return Vehicle(name or ('pendulum' if plant == 'pendulum' else 'vehicle'), plant, (plan,))


def _plant(trajectory: Trajectory) -> Plant:
    names = set(trajectory.state_names)
    if set(PENDULUM.state_names) <= names:
        return 'pendulum'
    return 'robot' if set(ROBOT.state_names) <= names else 'other'


def _missing(document: Mapping[str, Any], figures: PlanFigures) -> tuple[str, ...]:
    found = ['This is a plan that was not recorded being carried out: nothing is measured.']
    if not figures.parameters:
        found.append(
            'The file does not hold the parameters of the problem: limits and dimensions cannot '
            'be drawn. Files written by this version of tdm do.'
        )
    if 'verification' not in document:
        found.append('The file does not hold the margins of the plan.')
    return tuple(found)
