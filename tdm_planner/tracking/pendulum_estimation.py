# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The pendulum's state, and what its constants are against those of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tdm_planner.parameters import parameter, Validated
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.tracking.estimator import (
    EstimatorNoise,
    GAIN_UNKNOWN,
    LARGEST_STEP,
    PlantWithGains,
    StateEstimator,
)
from tdm_planner.tracking.tracker_parameters import NOISE

GAINS = 'gravity_gain', 'arm_gain', 'disk_gain', 'coupling_gain', 'torque_gain'

_FINE = 0.1  # of the time scale of the quickest swings: steps of gains and predictions, at most
_RATE_NOISE = 0.0094  # of w0; .1 rad/s of the default rig
# Rates below this share of w0^2 count as that: the estimator must not trust the model blindly.
_RATE_FLOOR = 0.1
_LASTING = 0.05  # 1 / w0 for which an error of the model's accelerations stays the same
_GAIN_SPREAD = 0.05  # standard deviation of the gains before anything is known of them


@dataclass(frozen=True)
class EstimatorParameters(Validated):
    """What the state estimator assumes."""

    angle_noise: float = parameter(
        0.0015, 'standard deviation of measured angles', unit='rad', allowed=NOISE
    )
    rate_noise: float | None = parameter(
        None,
        "standard deviation of measured rates; unset: in proportion to the rig's speed",
        unit='rad/s',
        allowed=NOISE,
    )
    model_error: float = parameter(
        0.1, "relative error of the model's accelerations", allowed=NOISE
    )


class EstimatedPendulum(PlantWithGains):
    """
    The pendulum with five more states: its constants over those of the model.

    The pendulum's own inertia is the model's: only ratios of inertias and torques matter. Those of
    the coupling and of what the disk feels of a tilted pendulum hardly differ.
    """

    state_names = (*RotaryPendulum.state_names, *GAINS)
    state_units = (*RotaryPendulum.state_units, *[''] * len(GAINS))
    control_names = RotaryPendulum.control_names
    control_units = RotaryPendulum.control_units

    @staticmethod
    def equations(
        k: Coefficients, state: Sequence[Any], control: Sequence[Any]
    ) -> tuple[Any, ...]:
        """Return the rates of the states; the arguments may hold numbers, arrays or symbols."""
        *motion, gravity, arm, disk, coupling, motor = state
        true = k._replace(
            gravity=gravity * k.gravity,
            arm=arm * k.arm,
            disk=disk * k.disk,
            coupling=coupling * k.coupling,
            disk_sine=coupling * k.disk_sine,
        )
        torque = [motor * part for part in control]
        return (*RotaryPendulum.equations(true, motion, torque), *[0.0] * len(GAINS))


def longest_step(plant: RotaryPendulum) -> float:
    """Return the longest step [s] in which a prediction is accurate."""
    return min(LARGEST_STEP, _FINE / plant.natural_frequency / plant.quickness)


def pendulum_estimator(
    plant: RotaryPendulum, assumed: EstimatorParameters, longest_gap: float
) -> StateEstimator:
    """Return the estimator of the pendulum's states and of the gains (9,)."""
    frequency, rate_noise = plant.natural_frequency, assumed.rate_noise
    if rate_noise is None:
        rate_noise = _RATE_NOISE * frequency
    measured, gains = [assumed.angle_noise] * 2 + [rate_noise] * 2, len(GAINS)
    noise = EstimatorNoise(
        measurement=np.array(measured + [GAIN_UNKNOWN] * gains),
        model=assumed.model_error,
        rate_floor=np.full(4 + gains, _RATE_FLOOR * frequency**2),
        driven=np.array([False, False, True, True] + [False] * gains),
        lasting=_LASTING / frequency,
        prior=np.array(measured + [_GAIN_SPREAD] * gains),
    )
    angles = np.array([True] + [False] * (3 + gains))
    estimated, step = EstimatedPendulum(plant), longest_step(plant)
    return StateEstimator(estimated, noise, angles, longest_gap, step)
