# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `plant`: the plant of any problem; of a stated one by its `derivative`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
import sys
from types import MappingProxyType
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
import numpy as np
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.tracker_plans import TOPIC
from tdm_planner.parameters import group, NON_NEGATIVE, parameter, ParameterSpec, SIGNED
from tdm_planner.plant_kind import kind_of
from tdm_planner.plant_views import StatedView
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.tracking.tracked_plants import problem_of, stated_problem, with_parameters_of
from tdm_sim.pendulum_plant import PendulumModel
from tdm_sim.plant_node import (
    Disturbance,
    MarkerParameters,
    PlantModel,
    PlantNode,
    SimulationParameters,
)
from tdm_sim.robot_plant import RobotModel
from tdm_sim.simulation import mismatched, PlantSetup, SimulatedPlant

_LARGEST_CONTROL = 1e9  # of what has no limits

PROBLEM = ParameterSpec(
    name='problem',
    kind=str,
    default='',
    description='the problem whose plant this is: module:Class, or an installed name',
    read_only=True,
)


@dataclass(frozen=True)
class StatedDisturbance(Disturbance):
    """Disturbances of the plant."""

    impulse: float = parameter(
        0.1, 'jump of the last state by one push, as a share of its unit', allowed=SIGNED
    )


@dataclass(frozen=True)
class StatedPlantParameters(SimulationParameters):
    """Parameters of the node beside those of the problem; `start.*` are the initial state."""

    noise: float = parameter(
        0.0, 'standard deviation of every measured state, in its unit', allowed=NON_NEGATIVE
    )
    held: bool = parameter(
        True,
        'stay in the initial state until a tracker executes a plan (tracker_status), or until the '
        'first command that is not zero',
    )
    disturbance: StatedDisturbance = group(StatedDisturbance)
    markers: MarkerParameters = group(MarkerParameters)


class StatedModel(PlantModel):
    """
    The plant of a `DirectProblem`, in the problem's start; controls act in `control_limits`.

    Its joints are those of the problem, see `tdm_planner.plant_kind`.
    """

    def __init__(self, problem: type[DirectProblem], node: PlantNode) -> None:
        self._problem, self._node = problem, node
        self.kind = kind_of(problem())
        self.parameters = with_parameters_of(StatedPlantParameters, problem, besides=('solver',))
        node.create_subscription(GoalStatusArray, TOPIC, self._on_tracker_status, LATCHED)

    def _on_tracker_status(self, message: GoalStatusArray) -> None:
        """Release the plant when a plan has begun, even one that begins with controls of zero."""
        if any(goal.status == GoalStatus.STATUS_EXECUTING for goal in message.status_list):
            self._node.release()

    def make_setup(self, parameters: Any) -> PlantSetup:
        """Return the plant, its limits and its disturbances as `parameters` say."""
        problem = problem_of(self._problem, parameters)
        plant = DirectPlant(mismatched(problem, parameters.mismatch, parameters.mismatch_seed))
        begin = np.nan_to_num(Ends.of(CheckedFormulation(problem)).states[0])
        lower, upper = np.clip(plant.control_range, -_LARGEST_CONTROL, _LARGEST_CONTROL)
        return PlantSetup(
            plant=plant,
            initial=begin,
            lower=lower,
            upper=upper,
            noise=np.full(begin.size, parameters.noise),
            command_timeout=parameters.command_timeout,
            command_loss=parameters.disturbance.command_loss,
            held=parameters.held,
        )

    def drawn(self, parameters: Any) -> StatedView:
        """Return the plant as its `drawing` has it with these parameters."""
        return StatedView(problem_of(self._problem, parameters)).checked()

    def push(self, parameters: Any, simulation: SimulatedPlant) -> str:
        """Let the last state jump."""
        impulse, name = parameters.disturbance.impulse, self.kind.state_names[-1]
        jump = impulse * np.eye(len(self.kind.state_names))[-1]
        simulation.push(lambda state: state + jump)
        return f"pushed: '{name}' by {impulse:g}"


_BUILT_IN: Mapping[str, Callable[[PlantNode], PlantModel]] = MappingProxyType(
    {'pendulum_swing_up': PendulumModel, 'robot_formation': RobotModel}
)


def _model_of(node: PlantNode) -> PlantModel:
    """Return the plant of the problem that the node's parameter names."""
    name = str(node.parameter_values[PROBLEM.name])
    if name in _BUILT_IN:
        return _BUILT_IN[name](node)
    return StatedModel(stated_problem(name), node)


StatedPlant = partial(PlantNode, 'plant', _model_of, MappingProxyType({PROBLEM.name: PROBLEM}))
main = partial(run, StatedPlant)

if __name__ == '__main__':
    sys.exit(main())
