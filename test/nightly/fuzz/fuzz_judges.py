# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What must hold for every case: a plan that was verified, or a refusal that says why, in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import json
import signal
from typing import Any

from tdm_planner.exceptions import Infeasible, InvalidProblem, TdmError
from tdm_planner.parameters import flatten, shown
from tdm_planner.problems.base import Problem, Solution

DEADLINE = 0.05  # s a search may take in these tests
ALLOWANCE = 4.0  # s of processor time beyond it: the step under way, the check, the interpreter


class Hang(BaseException):
    """A case took far longer than it may; no handler of errors must swallow it."""


@contextmanager
def limited(seconds: float = DEADLINE + ALLOWANCE) -> Iterator[None]:
    """Interrupt what takes more than `seconds` of processor time: other load does not count."""

    def interrupt(number: int, frame: Any) -> None:
        raise Hang(f'more than {seconds:g} s of processor time')

    before = signal.signal(signal.SIGPROF, interrupt)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def outcome(act: Callable[[], Any], case: Any, seconds: float = DEADLINE + ALLOWANCE) -> Any:
    """
    Return what `act` returns, or the package's own error that it raises; all else is an escape.

    An escape is reported with its case as the corpus keeps it.
    """
    try:
        with limited(seconds):
            return act()
    except TdmError as error:
        sentence = str(error)
        assert sentence, case
        assert '\n' not in sentence, (sentence, case)
        assert len(sentence) < 2000, (len(sentence), case)
        return error
    except (Exception, Hang) as error:  # noqa: B902
        raise AssertionError(
            f'{type(error).__name__}: {str(error)[:300]}\nto be kept in test/fuzz/corpus: '
            + json.dumps(case, default=repr)[:4000]
        ) from error


def planned(
    problem_class: type[Problem], parameters: Mapping[str, Any], deadline: float = DEADLINE
) -> Solution | TdmError:
    """Plan with a short deadline; a solution must be verified, a refusal must name its cause."""
    found = outcome(
        lambda: problem_class.from_parameters(parameters).solve(deadline=deadline, seed=0),
        dict(parameters),
        deadline + ALLOWANCE,
    )
    if isinstance(found, Solution):
        assert found.verification.ok
        assert json.dumps(found.to_dict(), allow_nan=False)
    else:
        assert isinstance(found, InvalidProblem | Infeasible), found
        if isinstance(found, InvalidProblem):
            names_a_field(problem_class, parameters, str(found))
    return found


def names_a_field(
    problem_class: type[Problem], parameters: Mapping[str, Any], sentence: str
) -> None:
    """Check that a refusal says which parameter, group of parameters or robot it is about."""
    try:
        flat = list(flatten(parameters))
    except InvalidProblem:
        flat = []
    names = {shown(str(name)) for name in [*parameters, *flat]} | set(
        _specifications(problem_class)
    )
    robots = {name.split('.')[0] for name in names if '.start.' in name}
    groups = {name.rsplit('.', 1)[0] + '.*' for name in names if '.' in name}
    found = any(f"'{name}'" in sentence or f' {name} ' in sentence for name in names | groups)
    found = found or any(f"'{name[:77]}" in sentence for name in names if len(name) > 77)
    assert found or any(f"'{robot}'" in sentence for robot in robots), sentence


def _specifications(problem_class: type[Problem]) -> list[str]:
    return list(problem_class.parameter_specifications({}))
