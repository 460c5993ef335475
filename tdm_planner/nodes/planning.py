# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""One request, from parameters and measured state to a verified plan or the reason for none."""

from __future__ import annotations

from collections.abc import Mapping
import time
from typing import Any

from tdm_planner.exceptions import (
    DeadlineExceeded,
    Infeasible,
    InvalidProblem,
    NoState,
    TdmError,
    VerificationFailed,
)
from tdm_planner.nodes.adapter import Adapter
from tdm_planner.nodes.clocks import MotionClock, NO_TIME
from tdm_planner.problems.problem import Problem
from tdm_planner.replanning import ActivePlan

_SHARES = (1.0, 0.5, 0.25)  # of `start.delay`, after which a motion may begin
_SHORTEST = 0.01  # s; no plan is found in less
_PREPARING = 0.5  # share of `start.delay` that is left when a plan is ready
_MARGIN = 0.1  # s that checking and publishing a plan may take
_LOOK = 0.002  # s between looks at the clock, and for a first state
_PATIENCE = 10.0  # s, the longest wait for a first state: BUSY is answered meanwhile


def make_plan(
    problem_class: type[Problem],
    values: Mapping[str, Any],
    adapter: Adapter,
    clock: MotionClock,
) -> ActivePlan:
    """
    Plan for the parameters `values` (the problem's and the request's), at the present of `clock`.

    From a measured state, plan for an earlier start than `start.delay` if that is infeasible: a
    plant in motion may have left its limits by then.

    Raise TdmError saying why there is no plan.
    """
    measured = values['start.source'] == 'measured' and adapter.measures
    if measured:
        _await_first_state(adapter, values['start.max_age'], clock)
    if not clock.runs:
        raise NoState(NO_TIME)
    failure: TdmError | None = None
    now = _after_a_start(adapter, values, clock) if measured else clock.now()
    delays = [share * values['start.delay'] for share in (_SHARES if measured else _SHARES[:1])]
    starts = [now + delay for delay in delays]
    for delay, start, sooner in zip(delays, starts, [*starts[1:], None], strict=True):
        begin = adapter.measured_start(values, now, start) if measured else {}
        try:
            problem = problem_class.from_parameters({**values, **begin})
            allowed = problem.solver.deadline
            if failure is not None:
                allowed = min(allowed, _time_until(start, sooner, clock.now()))
                if allowed < _SHORTEST:
                    break
            solution = problem.solve(deadline=allowed)
            check = solution.verification
            if not check.ok:  # a user's problem may return it nevertheless
                why = '; '.join(check.reasons) or 'it gives no reasons'
                raise VerificationFailed(f'the plan is not verified: {why}')
            if not measured or adapter.rests(now):  # solving may have left too little time
                start = max(start, clock.now() + _PREPARING * delay)
            return ActivePlan(problem, solution, start)
        except (InvalidProblem, Infeasible) as error:
            final = isinstance(error, (DeadlineExceeded, VerificationFailed))
            if not measured or (final and failure is None):
                raise
            failure = failure or _with_prediction_note(error, delay)
    assert failure is not None
    raise failure


def _await_first_state(adapter: Adapter, max_age: float, clock: MotionClock) -> None:
    """Wait at most `max_age` s for simulated time and first states; NoState names what misses."""
    longest = min(max_age, _PATIENCE)
    end = time.monotonic() + longest
    while (not clock.runs or adapter.missing()) and time.monotonic() < end:
        time.sleep(_LOOK)
    missing = adapter.missing()
    if missing and clock.runs:
        raise NoState(f'{"; ".join(missing)} within {longest:g} s (start.max_age)')


def _time_until(start: float, sooner: float | None, now: float) -> float:
    """Time [s] to plan what begins at `start`; half is left for what may begin `sooner`."""
    half = 0.0 if sooner is None else 0.5 * (sooner - now)
    return half if half >= _SHORTEST else start - now


def _after_a_start(adapter: Adapter, values: Mapping[str, Any], clock: MotionClock) -> float:
    """Return the instant to plan at [s]: the present, or the start of a plan that begins soon."""
    # From that start on the plant follows the pending plan; until then, the one before.
    now = clock.now()
    begins = adapter.plans.next_start(now)
    longest = max(values['solver.deadline'], _SHARES[1] * values['start.delay']) + _MARGIN
    if begins is None or begins - now > longest:
        return now
    patience = time.monotonic() + 2.0 * longest  # simulated time may stand still
    while (now := clock.now()) < begins and time.monotonic() < patience:
        time.sleep(_LOOK)
    return now


def _with_prediction_note(error: TdmError, delay: float) -> TdmError:
    """Return the error; if it names the start, note that the start was predicted."""
    text = str(error)
    if 'start' in text:
        text += f' (as predicted from the measured state for {delay:g} s later, start.delay)'
    return type(error)(text)
