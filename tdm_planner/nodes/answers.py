# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How a plan or a failure is reported: service responses, `plan_summary`, diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import json
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from std_srvs.srv import Trigger
from tdm_planner.exceptions import Failure
from tdm_planner.plan_files import finite
from tdm_planner.plant_kind import plan_kind, QUANTITIES
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning import ActivePlan
from tdm_planner.trajectory import Trajectory

_SECOND = 1_000_000_000  # ns


@dataclass(frozen=True, eq=False)
class Request:
    """
    Who asked for a plan, and for which.

    `answer` gets the figures of the plan as JSON, or why there is none; None if no client waits:
    plans of reviews, recovered plans. `changes` are parameters to plan with instead of the node's:
    for this plan alone, or, if they are `lasting`, set on the node with the plan. `title` begins
    the log's line about a failure.
    """

    answer: Callable[[str | Failure], None] | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    lasting: bool = False
    title: str = 'no plan'


def service_response(request: Any, outcome: str | Failure) -> Any:
    """Return the response of `plan` or `plan_with`: figures of the plan, or code and reason."""
    success = not isinstance(outcome, Failure)
    text = outcome.to_json() if isinstance(outcome, Failure) else outcome
    if isinstance(request, Trigger.Request):
        return Trigger.Response(success=success, message=text)
    result = SetParametersResult(successful=success, reason=text)
    return SetParametersAtomically.Response(result=result)


def plan_answer(plan: ActivePlan, plan_id: int, warnings: Sequence[str] = ()) -> str:
    """
    Return the response of the `plan` service with a plan, one line of JSON.

    `warnings` are sentences about what is not connected; without any, the key is absent.
    """
    solution = plan.solution
    added = {'warnings': list(warnings)} if warnings else {}
    document = {
        'plan_id': plan_id,
        'duration': solution.duration,
        'cost': solution.cost,
        'penalty': solution.penalty,
        'solve_time': solution.solve_time,
        'evaluations': solution.evaluations,
        'summary': ' '.join(solution.summary.split()),
        **added,
    }
    return json.dumps(finite(document), allow_nan=False)


def plan_summary(plan: ActivePlan, plan_id: int, stamp: int) -> str:
    """
    Return everything about a plan but its samples, one line of JSON, for recordings.

    It holds the figures of the response; `stamp` [ns], the start of the motion; the terms of the
    cost; the verification, with the instants of the worst margins; per vehicle, what trajectory
    messages lack, such as the states and controls of their joints; the problem's parameters by
    dotted name. A number that is not finite is null.
    """
    solution = plan.solution
    document = {
        'plan_id': plan_id,
        'stamp': {'sec': stamp // _SECOND, 'nanosec': stamp % _SECOND},
        **solution.figures,
        'summary': ' '.join(solution.summary.split()),
        'verification': solution.verification.to_dict(),
        'vehicles': {
            name: {
                'duration': trajectory.duration,
                'interpolation': trajectory.interpolation,
                'units': trajectory.units,
                'states': trajectory.state_names,
                'controls': trajectory.control_names,
                'joints': _joints(plan.problem, trajectory),
            }
            for name, trajectory in solution.trajectories.items()
        },
        'parameters': plan.problem.to_parameters(),
    }
    return json.dumps(finite(document), allow_nan=False)


def _joints(problem: Problem, trajectory: Trajectory) -> dict[str, dict[str, str]]:
    """Return the states and controls that are position, velocity and effort of every joint."""
    return {
        joint.name: {what: getattr(joint, what) for what in QUANTITIES if getattr(joint, what)}
        for joint in plan_kind(problem, trajectory).joints
    }


def plan_figures(plan: ActivePlan, now: float) -> dict[str, Any]:
    """Return what the diagnostics show of the active plan."""
    solution = plan.solution
    check = solution.verification
    figures: dict[str, Any] = {
        'plan age [s]': now - plan.start,
        'duration [s]': solution.duration,
        'cost': float(solution.cost),
        'penalty': float(solution.penalty),
        'solve time [s]': solution.solve_time,
        'evaluations': solution.evaluations,
    }
    if check.worst:
        narrowest = min(check.worst, key=lambda name: check.worst[name])
        figures['worst margin'] = f'{check.worst[narrowest]:.6g} ({narrowest})'
    figures.update({f'margin of {name}': float(value) for name, value in check.worst.items()})
    return figures
