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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import json
from typing import Any, NamedTuple

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from std_srvs.srv import Trigger
from tdm_planner.exceptions import Failure
from tdm_planner.nodes.services import Answer
from tdm_planner.plan_files import finite
from tdm_planner.plant_kind import plan_kind, QUANTITIES
from tdm_planner.problems.base import Problem
from tdm_planner.replanning import ActivePlan
from tdm_planner.trajectory import Trajectory

_SECOND = 1_000_000_000  # ns


class MovedGoal(NamedTuple):
    """Parameters that a goal tool changes; they are set if there is a plan with them."""

    changes: Mapping[str, Any]
    purpose: str


@dataclass(frozen=True, eq=False)
class Request:
    """
    A request to be answered: of `plan` or `plan_with`, or a moved goal.

    `own` are the parameters of this request alone. Plans of reviews and recovered plans have no
    `message`, and no client waits for them.
    """

    message: Any = None
    send: Answer = lambda _: None
    own: Mapping[str, Any] = field(default_factory=dict)
    title: str = 'no plan'  # of the log's line about a failure

    @property
    def changes(self) -> Mapping[str, Any]:
        """Return the parameters that are planned with instead of the node's."""
        return self.message.changes if isinstance(self.message, MovedGoal) else self.own

    @property
    def wants_figures(self) -> bool:
        """Whether a service's client waits for the figures of the plan."""
        return self.message is not None and not isinstance(self.message, MovedGoal)

    def answer(self, outcome: str | Failure) -> None:
        """Send the response that fits the request: figures of the plan, or code and reason."""
        success = not isinstance(outcome, Failure)
        if isinstance(self.message, MovedGoal):
            self.send('' if isinstance(outcome, str) else f'{outcome.code}: {outcome.reason}')
            return
        text = outcome if isinstance(outcome, str) else outcome.to_json()
        if isinstance(self.message, Trigger.Request):
            self.send(Trigger.Response(success=success, message=text))
        else:
            result = SetParametersResult(successful=success, reason=text)
            self.send(SetParametersAtomically.Response(result=result))


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
