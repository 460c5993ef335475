# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The thruster turns as the wanted acceleration does, as fast as it can."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.problems.thrust_direction import ThrustDirection

TIMES = np.linspace(0.0, 20.0, 401)


RATE, THRUST = 1.0, 0.1


def lateral_error(wanted, yaw, alpha):
    """Largest component of the wanted acceleration across the thrust, or against it."""
    heading = alpha + yaw
    across = wanted[:, 1] * np.cos(heading) - wanted[:, 0] * np.sin(heading)
    along = wanted[:, 0] * np.cos(heading) + wanted[:, 1] * np.sin(heading)
    return float(np.hypot(across, np.minimum(along, 0.0)).max())


def flip(offset=0.0, turns=1):
    """Accelerate and brake `turns` times along x, passing zero at a lateral `offset`."""
    along = THRUST * np.cos(turns * np.pi * TIMES / TIMES[-1])
    return np.stack([along, np.full_like(along, offset)], axis=1)


def follow(wanted, alpha=np.nan, rate=RATE):
    return ThrustDirection(TIMES, wanted, np.zeros(TIMES.size), rate, THRUST, alpha).follow(wanted)


@given(
    seed=st.integers(0, 500),
    alpha=st.one_of(st.just(np.nan), st.floats(-3.0, 3.0)),
    rate=st.floats(0.2, 3.0),
)
@settings(deadline=None, max_examples=40, derandomize=True)
def test_never_turns_faster_than_the_limit(seed, alpha, rate):
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(0, 1, (2, 4))
    s = 2 * TIMES / TIMES[-1] - 1
    wanted = THRUST * np.stack([np.polynomial.chebyshev.chebval(s, c) for c in coefficients], 1)
    yaw = 0.3 * np.sin(TIMES * rng.uniform(0.1, 0.6))
    angle, speed = ThrustDirection(TIMES, wanted, yaw, rate, THRUST, alpha).follow(wanted)
    assert np.abs(speed).max() <= rate
    steps = np.diff(TIMES) * (speed[1:] + speed[:-1]) / 2
    assert np.diff(angle) == pytest.approx(steps, abs=1e-12)
    if not np.isnan(alpha):
        assert angle[0] == alpha


def test_follows_a_slow_direction_exactly():
    heading = 0.5 * np.sin(0.5 * TIMES)
    wanted = 0.05 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    yaw = 0.2 * TIMES
    angle, _ = ThrustDirection(TIMES, wanted, yaw, RATE, THRUST, np.nan).follow(wanted)
    assert angle == pytest.approx(heading - yaw, abs=1e-3)


def test_turns_round_while_little_thrust_is_wanted_and_a_slower_thruster_errs_more():
    wanted = flip()
    angles = [follow(wanted, rate=rate)[0] for rate in (2.0, RATE, 0.5)]
    assert abs(angles[1][-1] - angles[1][0]) == pytest.approx(np.pi, abs=1e-6)
    # Half a turn takes pi s; while it is more than pi / 2 off, at most as long to either side, the
    # wanted acceleration is under sin(pi^2 / 40) F_max.
    errors = [lateral_error(wanted, 0.0, angle) for angle in angles]
    assert errors[1] < 1.3 * THRUST * np.sin(np.pi**2 / 40)
    assert errors[0] < errors[1] < errors[2]


def test_the_branch_survives_small_changes():
    """The direction of a turn must not change when the wanted acceleration changes a little."""
    wanted, yaw = flip(1e-4 * THRUST, turns=3), np.zeros(TIMES.size)
    direction = ThrustDirection(TIMES, wanted, yaw, RATE, THRUST, np.nan)
    first, _ = direction.follow(wanted)
    second, _ = direction.follow(flip(-1e-4 * THRUST, turns=3))
    assert second == pytest.approx(first, abs=0.2)


def test_starts_where_the_thruster_stands_and_turns_during_a_coast():
    angle, speed = follow(np.where(TIMES[:, None] < 3.0, 0.0, [[0.08, 0.0]]), 2.5)
    assert angle[0] == 2.5
    assert angle[TIMES > 3.0] == pytest.approx(0.0, abs=1e-3)
    assert np.abs(speed).max() <= RATE
    resting, speed = follow(np.zeros((401, 2)), 0.7)
    assert (resting == 0.7).all()
    assert not speed.any()
