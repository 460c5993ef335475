# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One row of a study: a plan, its verification, and its closed-loop runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tdm_planner.exceptions import PlannerFault, TdmError
from tdm_planner.problems.problem import Problem
from tdm_sim.study.axes import Point
from tdm_sim.study.flights import ClosedLoop, measured

Row = dict[str, Any]

MARGIN = 'margin.'  # before the name of a limit: what the plan leaves of it at worst


@dataclass(frozen=True)
class Trial:
    """
    Computes a point: the plan and, with a closed loop, its runs.

    `parameters` are those that all points share. The result is the row without its parameters. It
    depends on the point alone, not on the clock or the order of points.
    """

    problem: type[Problem]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    closed_loop: ClosedLoop | None = None

    def __call__(self, point: Point) -> Row:
        """Return the row of a point."""
        try:
            return self._tried(point)
        except TdmError as error:
            return failed(error.code, str(error))
        except Exception as error:  # noqa: B902
            # A fault of the program or of a user's problem: the study goes on.
            return failed(PlannerFault.code, f'{type(error).__name__}: {error}')

    def lost(self, point: Point) -> Row:
        """Return the row of a point at which every process died."""
        del point
        return failed(PlannerFault.code, 'every process that computed it died')

    def _tried(self, point: Point) -> Row:
        problem = self.problem.from_parameters({**self.parameters, **point})
        solution = problem.solve(counted=True)
        row: Row = {
            'verified': True,
            'code': '',
            'reason': '',
            'cost': float(solution.cost),
            'duration': float(solution.duration),
            'solve_time': solution.solve_time,
            'evaluations': solution.evaluations,
        }
        check = solution.verification
        row |= {f'{MARGIN}{name}': float(value) for name, value in check.worst.items()}
        if self.closed_loop is not None:
            row |= measured(problem, solution, self.closed_loop)
        return row


def failed(code: str, reason: str) -> Row:
    """Return the row of a point without a plan."""
    nothing = dict.fromkeys(('cost', 'duration', 'solve_time', 'evaluations'))
    return {'verified': False, 'code': code, 'reason': reason, **nothing}
