# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from tdm_planner.parameters import to_mapping
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_sim.mismatch import mismatched, mismatched_gains

SETTINGS = settings(deadline=None, max_examples=50, derandomize=True)


def relative_errors(plant: object, mismatch: float, seed: int) -> np.ndarray:
    nominal, disturbed = to_mapping(plant), to_mapping(mismatched(plant, mismatch, seed))
    assert list(nominal) == list(disturbed)
    return np.array([disturbed[name] / nominal[name] - 1.0 for name in nominal])


@SETTINGS
@given(mismatch=st.floats(0.0, 0.3), seed=st.integers(0, 2**40))
def test_errors_are_bounded_and_follow_from_the_seed(mismatch: float, seed: int) -> None:
    for plant in (RotaryPendulum(), FloatingRobot()):
        errors = relative_errors(plant, mismatch, seed)
        assert (np.abs(errors) <= mismatch * (1 + 1e-12) + 1e-12).all()
        assert mismatched(plant, mismatch, seed) == mismatched(plant, mismatch, seed)


def test_every_constant_has_an_error_of_its_own() -> None:
    errors = relative_errors(RotaryPendulum(), 0.05, 3)
    assert errors.size == 8
    assert np.unique(errors).size == 8
    assert not np.array_equal(errors, relative_errors(RotaryPendulum(), 0.05, 4))


def test_errors_are_uniform() -> None:
    errors = np.concatenate([relative_errors(RotaryPendulum(), 0.05, seed) for seed in range(200)])
    assert abs(errors.mean()) < 0.003
    assert abs(errors.std() - 0.05 / np.sqrt(3)) < 0.002


def test_no_mismatch_is_the_plant_itself() -> None:
    plant = RotaryPendulum(mass=0.03)
    assert mismatched(plant, 0.0, 5) == plant
    np.testing.assert_array_equal(mismatched_gains(3, 0.0, 5), np.ones(3))


def test_gains_are_bounded_seeded_and_not_the_plants_errors() -> None:
    gains = mismatched_gains(3, 0.05, 7)
    assert (np.abs(gains - 1.0) <= 0.05).all()
    assert np.unique(gains).size == 3
    np.testing.assert_array_equal(gains, mismatched_gains(3, 0.05, 7))
    assert not np.allclose(gains - 1.0, relative_errors(FloatingRobot(), 0.05, 7))
