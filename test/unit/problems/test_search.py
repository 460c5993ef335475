# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The outer loop that all problems share, on candidates that are plain numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import Infeasible
from tdm_planner.problems import PendulumSwingUp, Plan
from tdm_planner.problems.search import Search
from tdm_planner.verification import Verification


class Scripted(Search[float]):
    """Rounds of candidates as given; the k-th plan of a candidate c costs c and passes if told."""

    def __init__(
        self,
        rounds: list[list[float]],
        passing: dict[float, int],
        satisfying: set[float] | None = None,
        seconds: float = 60.0,
    ) -> None:
        super().__init__(Budget(seconds))
        self.rounds = rounds
        self.passing = passing
        self.satisfying = satisfying
        self.round = 0
        self.checked: list[tuple[float, int]] = []

    def candidates(self) -> Iterable[float]:
        return self.rounds[self.round]

    def plans(self, candidate: float) -> Iterator[Plan]:
        for k in range(3):
            self.checked.append((candidate, k))
            ok = self.passing.get(candidate, 9) == k
            reasons = () if ok else (f'plan {k} of {candidate:g} fails',)
            check = Verification(ok=ok, terminal_error=np.zeros(1), reasons=reasons)
            yield Plan({}, check, candidate, np.zeros(0), 0.0)

    def satisfied_with(self, plan: Plan) -> bool:
        return self.satisfying is None or plan.cost in self.satisfying

    def widen(self) -> bool:
        self.round += 1
        return self.round < len(self.rounds)

    def failure(self) -> Infeasible:
        return Infeasible(self.rejected or 'nothing found')


def test_the_first_satisfying_plan_ends_the_search_after_failed_checks() -> None:
    search = Scripted([[1.0, 2.0]], {1.0: 1, 2.0: 0})
    assert search.run().cost == 1.0
    assert search.checked == [(1.0, 0), (1.0, 1)]
    assert search.rejected == 'plan 0 of 1 fails'


def test_cheapest_of_a_round_where_none_satisfies() -> None:
    search = Scripted([[3.0, 1.0, 2.0]], {1.0: 2, 2.0: 0, 3.0: 0}, satisfying=set())
    assert search.run().cost == 1.0


def test_candidates_that_promise_no_more_are_not_checked() -> None:
    class Ordered(Scripted):
        """Less is promised by a higher cost."""

        def promises_more(self, candidate: float, than: float) -> bool:
            return candidate < than

    search = Ordered([[2.0, 3.0, 1.0]], {1.0: 0, 2.0: 0, 3.0: 0}, satisfying=set())
    assert search.run().cost == 1.0
    assert [c for c, _ in search.checked] == [2.0, 1.0]


def test_another_round_after_one_without_a_plan() -> None:
    search = Scripted([[], [5.0], [4.0]], {4.0: 0, 6.0: 0})
    assert search.run().cost == 4.0
    assert search.round == 2


def test_failure_is_raised_with_the_last_reason() -> None:
    with pytest.raises(Infeasible, match='plan 2 of 7 fails'):
        Scripted([[6.0, 7.0]], {}).run()
    with pytest.raises(Infeasible, match='nothing found'):
        Scripted([[]], {}).run()


def test_no_further_round_when_the_time_is_spent() -> None:
    search = Scripted([[1.0], [2.0]], {2.0: 0}, seconds=0.0)
    with pytest.raises(Infeasible, match='of 1 fails'):
        search.run()
    assert search.round == 0


def broken(error: Exception) -> PendulumSwingUp:
    class Broken(PendulumSwingUp):
        """The pendulum's problem, whose first step fails."""

        def standing_plan(self) -> None:
            raise error

    return Broken()


@pytest.mark.parametrize(
    'error', [OverflowError('math range error'), FloatingPointError('the motion is too fast')]
)
def test_numbers_out_of_range_are_the_users(error: Exception) -> None:
    with pytest.raises(Infeasible, match=f'{error}.* are their units right') as caught:
        broken(error).solve()
    assert caught.value.__cause__ is error


@pytest.mark.parametrize(
    'error',
    [
        ZeroDivisionError('division by zero'),
        np.linalg.LinAlgError('Singular matrix'),
        ValueError('array must not contain infs or NaNs'),
        IndexError('list index out of range'),
    ],
)
def test_errors_of_the_program_pass_unchanged(error: Exception) -> None:
    with pytest.raises(type(error)) as caught:
        broken(error).solve()
    assert caught.value is error
