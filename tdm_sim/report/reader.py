# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A mission from a path: a recording or a plan file."""

from __future__ import annotations

from pathlib import Path

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plan_files import load_plan, vehicles
from tdm_planner.plant_views import view_of
from tdm_planner.problems.base import Problem
from tdm_planner.trajectory import Trajectory
from tdm_sim.report import untrusted
from tdm_sim.report.bag_files import UnreadableRecording
from tdm_sim.report.bag_reader import read_bag
from tdm_sim.report.mission import FollowedPlan, Mission, Vehicle
from tdm_sim.report.plan_documents import plan_figures, problem_of
from tdm_sim.report.recorded_vehicles import unknown_view


def read_mission(
    path: Path | str, namespace: str | None = None, problem: type[Problem] | None = None
) -> Mission:
    """
    Read a rosbag2 folder, a single .mcap or .db3 file, or a plan file (.json).

    A rosbag2 may be given by its metadata.yaml too. `namespace` chooses among several planners in
    one recording; `problem` is the class of a problem that is not installed.

    Raises
    ------
    TdmError
        In one sentence, if nothing can be made of it.

    """
    path = Path(path)
    if path.name == 'metadata.yaml' and path.is_file():
        path = path.parent
    if path.suffix.lower() != '.json':
        return read_bag(path, namespace, problem)
    if namespace is not None:
        raise UnreadableRecording(f"'{path}' is a plan, which has no namespaces to choose from")
    return _read_plan(path, problem)


def _read_plan(path: Path, given: type[Problem] | None) -> Mission:
    """Read a plan file of `tdm plan` or of a demo; raises InvalidProblem if it is none."""
    try:
        document = load_plan(path)
        trajectories = {
            untrusted.text(name, 60): Trajectory.from_dict(dict(part))
            for name, part in vehicles(document).items()
        }
    except (TypeError, ValueError, AttributeError, KeyError, RecursionError):
        raise InvalidProblem(f"the file '{path}' is not a plan written by tdm") from None
    name = untrusted.text(document['problem'], 100)
    figures = plan_figures(document, 0.0)
    missing = ['This is a plan that was not recorded being carried out: nothing is measured.']
    problem = problem_of(name, figures.parameters, given, missing)
    if not figures.parameters:
        missing.append(
            'The file does not hold the parameters of the problem: no limits are drawn.'
        )
    if 'verification' not in document:
        missing.append('The file does not hold the margins of the plan.')
    found = []
    for vehicle, motion in trajectories.items():
        view = unknown_view(motion) if problem is None else view_of(problem, motion)
        plan = FollowedPlan(motion, -float(motion.times[0]))
        found.append(Vehicle(vehicle or view.name, view, (plan,)))
    return Mission(
        title=found[0].view.title or f'Plan for {name}',
        problem=name,
        vehicles=tuple(found),
        figures=(figures,),
        parameters=figures.parameters,
        missing=tuple(missing),
        source=str(path),
    )
