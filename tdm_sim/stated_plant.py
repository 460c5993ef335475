# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Node `plant`: any stated problem, simulated by its `derivative`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import JointState
from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.stated_plants import (
    stated_problem,
    StatedMessages,
    with_parameters_of,
)
from tdm_planner.parameters import (
    group,
    NON_NEGATIVE,
    parameter,
    ParameterSpec,
    Range,
    SIGNED,
    Validated,
)
from tdm_planner.problems.direct_plant import TracedPlant
from tdm_planner.problems.direct_problem import DirectProblem
from tdm_sim.commands import read_joint
from tdm_sim.mismatch import mismatched
from tdm_sim.plant_node import MarkerParameters, PlantNode, SimulationParameters
from tdm_sim.simulation import PlantSetup
from visualization_msgs.msg import MarkerArray

Array = NDArray[np.float64]

_LARGEST_CONTROL = 1e9  # of what has no limits

PROBLEM = ParameterSpec(
    name='problem',
    kind=str,
    default='',
    description='the stated problem whose plant this is: module:Class, or an installed name',
    read_only=True,
)


@dataclass(frozen=True)
class StatedDisturbance(Validated):
    """What happens to the plant from outside."""

    impulse: float = parameter(
        0.1, 'jump of the last state by one push, as a share of its unit', allowed=SIGNED
    )
    command_loss: float = parameter(
        0.0, 'probability that a command is lost', allowed=Range(0.0, 1.0)
    )


@dataclass(frozen=True)
class StatedPlantParameters(SimulationParameters):
    """Parameters of the node beside those of the problem; `start.*` are the initial state."""

    noise: float = parameter(
        0.0, 'standard deviation of every measured state, in its unit', allowed=NON_NEGATIVE
    )
    held: bool = parameter(
        True, 'stay in the initial state until the first command that is not zero'
    )
    disturbance: StatedDisturbance = group(StatedDisturbance)
    markers: MarkerParameters = group(MarkerParameters)


class StatedPlant(PlantNode):
    """
    The plant of a `DirectProblem`.

    `joint_states`: the states, see `StatedMessages`; `joint_command`: the controls by their names,
    as efforts, which act within `control_limits`. The plant begins in the problem's start.
    """

    decisive = frozenset({PROBLEM.name})

    def __init__(self, **options: Any) -> None:
        super().__init__('plant', StatedPlantParameters, first={PROBLEM.name: PROBLEM}, **options)

    def parameters_of(self, base: type[Any]) -> type[Any]:
        """Return the parameters with those of the problem, its start among them."""
        self.problem_class = stated_problem(str(self.parameter_values[PROBLEM.name]))
        return with_parameters_of(base, self.problem_class, besides=('solver',))

    def _problem(self, parameters: Any) -> DirectProblem:
        kind: Any = self.problem_class
        names = {item.name for item in fields(kind)} - {'solver'}
        problem: DirectProblem = kind(**{name: getattr(parameters, name) for name in names})
        return problem

    def make_setup(self, parameters: Any) -> PlantSetup:
        """Return the plant, its limits and its disturbances as `parameters` say."""
        problem = self._problem(parameters)
        self.messages = StatedMessages(problem)
        true = mismatched(problem, parameters.mismatch, parameters.mismatch_seed)
        plant = TracedPlant(true)
        begin = np.nan_to_num(TracedPlant(problem).stated.start())
        limits = plant.stated.control_limits
        wide = (-_LARGEST_CONTROL, _LARGEST_CONTROL)
        bounds = np.array([limits.get(name, wide) for name in problem.control_names])
        return PlantSetup(
            plant=plant,
            initial=begin,
            lower=np.maximum(bounds[:, 0], -_LARGEST_CONTROL),
            upper=np.minimum(bounds[:, 1], _LARGEST_CONTROL),
            noise=np.full(begin.size, parameters.noise),
            command_timeout=parameters.command_timeout,
            command_loss=parameters.disturbance.command_loss,
        )

    def make_publishers(self) -> None:
        """Create the publisher of `joint_states`."""
        self._joint_states = self.create_publisher(JointState, 'joint_states', 10)

    def publish_state(self, measured: Array, stamp: Any) -> None:
        """Publish `joint_states`."""
        message = self.messages.state_message(measured)
        message.header.stamp = stamp
        self._joint_states.publish(message)

    def draw(self, measured: Array, now: Time, lifetime: float) -> MarkerArray:
        """Return nothing: a statement has no picture yet."""
        return MarkerArray()

    def read_command(self, message: JointState) -> Array:
        """Return the controls (nu,) of a command; the first that is not zero lets the plant go."""
        control = np.array([read_joint(message, n, 'effort') for n in self.messages.controls])
        self.held = self.held and not control.any()
        return control

    held = True

    def advance(self) -> Time:
        """Integrate up to the present, unless the plant is held."""
        if self.held and self.parameters.held and self._has_time:
            self._last = self._time.now()
        return super().advance()

    def moved_elsewhere(self) -> None:
        """Hold the plant again: it is in its initial state."""
        self.held = True

    def push_effect(self) -> tuple[Callable[[Array], Array], str]:
        """Return a jump of the last state."""
        impulse, name = self.parameters.disturbance.impulse, self.messages.states[-1]

        def effect(state: Array) -> Array:
            moved = state.copy()
            moved[-1] += impulse
            return moved

        return effect, f"pushed: '{name}' by {impulse:g}"

    def conditions(self) -> tuple[list[str], dict[str, Any]]:
        """Report whether the plant is held."""
        return [], {'held': self.held and self.parameters.held}


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is asked to end."""
    return run(StatedPlant, args)


if __name__ == '__main__':
    sys.exit(main())
