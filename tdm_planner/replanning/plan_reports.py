# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What is told of a plan besides its samples: in an answer, in recordings, in diagnostics."""

from __future__ import annotations

import json
from typing import Any

from tdm_planner.plan_files import finite
from tdm_planner.plant_views import view_of
from tdm_planner.replanning.execution import TimedPlan
from tdm_planner.trajectory import SECOND

_ANSWERED = ('duration', 'cost', 'penalty', 'solve_time', 'evaluations')


def plan_answer(plan: TimedPlan, plan_id: int) -> str:
    """Return the response of the `plan` service with a plan, one line of JSON."""
    solution = plan.solution
    document = {
        'plan_id': plan_id,
        **{name: getattr(solution, name) for name in _ANSWERED},
        'summary': ' '.join(solution.summary.split()),
    }
    return json.dumps(finite(document), allow_nan=False)


def plan_summary(plan: TimedPlan, plan_id: int, stamp: int) -> str:
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
        'stamp': {'sec': stamp // SECOND, 'nanosec': stamp % SECOND},
        **solution.figures,
        'summary': ' '.join(solution.summary.split()),
        'verification': solution.verification.to_dict(),
        'vehicles': {
            name: {
                'duration': trajectory.duration,
                **view_of(plan.problem, trajectory).kind.to_dict(),
                'interpolation': trajectory.interpolation,
            }
            for name, trajectory in solution.trajectories.items()
        },
        'parameters': plan.problem.to_parameters(),
    }
    return json.dumps(finite(document), allow_nan=False)


def plan_figures(plan: TimedPlan, now: float) -> dict[str, Any]:
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
