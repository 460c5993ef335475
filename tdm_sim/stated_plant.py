# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Node `plant`: the plant of any problem; of a stated one by its `derivative`."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from functools import partial
from itertools import zip_longest
from keyword import iskeyword
import sys
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
import numpy as np
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.collocation import Ends
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.runtime import run
from tdm_planner.nodes.tracker_plans import TOPIC
from tdm_planner.parameters import group, parameter, ParameterSpec, SIGNED, Validated
from tdm_planner.plant_kind import kind_of
from tdm_planner.plant_views import StatedView
from tdm_planner.problems.direct.plant import DirectPlant
from tdm_planner.problems.direct.problem import DirectProblem
from tdm_planner.tracking.tracked_plants import problem_of, stated_problem, with_parameters_of
from tdm_sim.pendulum_plant import PENDULUM_MODEL
from tdm_sim.plant_node import (
    deviation,
    PlantModel,
    PlantNode,
    SimulationParameters,
)
from tdm_sim.robot_plant import ROBOT_MODEL
from tdm_sim.simulation import mismatched, PlantSetup, SimulatedPlant

PROBLEM = ParameterSpec(
    'problem',
    str,
    '',
    'the problem whose plant this is: module:Class, or an installed name',
    read_only=True,
)


@dataclass(frozen=True)
class StatedDisturbance(Validated):
    """Disturbances of the plant."""

    impulse: float = parameter(
        0.1, 'jump of the last state by one push, as a share of its unit', allowed=SIGNED
    )


@dataclass(frozen=True)
class StatedPlantParameters(SimulationParameters):
    """Parameters of the node beside those of the problem and of every state."""

    held: bool = parameter(
        False,
        'stay in the initial state until a tracker executes a plan (tracker_status), or until the '
        'first command that is not zero',
    )
    disturbance: StatedDisturbance = group(StatedDisturbance)


def _with_states(problem: type[DirectProblem]) -> type[StatedPlantParameters]:
    """Return the parameters with `initial` and `noise` of every state that can name a field."""
    units = zip_longest(problem.state_names, problem.state_units, fillvalue='')
    states = [(n, u) for n, u in units if n.isidentifier() and not iskeyword(n)]
    initial, noise = (
        make_dataclass(f'Stated{kind}', fields, bases=(Validated,), frozen=True)
        for kind, fields in (
            ('Initial', [(name, float | None, _initial(name, unit)) for name, unit in states]),
            ('Noise', [(name, float, deviation(f"'{name}'", unit)) for name, unit in states]),
        )
    )
    groups: list[Any] = [('initial', initial, group(initial)), ('noise', noise, group(noise))]
    base = StatedPlantParameters
    return make_dataclass(base.__name__, groups, bases=(base,), frozen=True)


def _initial(state: str, unit: str) -> Any:
    text = f"initial value of '{state}'; unset: as the problem begins"
    return parameter(None, text, unit=unit, allowed=SIGNED)


def _stated_model(problem: type[DirectProblem], node: PlantNode) -> PlantModel:
    """Return the plant of a problem; controls act in `control_limits`."""
    kind = kind_of(problem())

    def setup(given: Any) -> PlantSetup:
        made = problem_of(problem, given)
        plant = DirectPlant(mismatched(made, given.mismatch, given.mismatch_seed))
        begin, start = Ends.of(CheckedFormulation(made)).states[0], getattr(made, 'start', None)
        for number, name in enumerate(kind.state_names):
            initial = getattr(given.initial, name, None)
            if initial is None and np.isnan(begin[number]):  # conditions may ask for it
                initial = getattr(start, name, None) or 0.0
            begin[number] = begin[number] if initial is None else initial
        noise = np.array([getattr(given.noise, name, 0.0) for name in kind.state_names])
        return PlantSetup(plant, begin, plant.control_range, noise, held=given.held)

    def push(given: Any, simulation: SimulatedPlant, _: str) -> str:
        """Let the last state jump."""
        impulse = given.disturbance.impulse
        simulation.push(lambda state: state + impulse * np.eye(state.size)[-1])
        return f"pushed: '{kind.state_names[-1]}' by {impulse:g}"

    def on_tracker_status(message: GoalStatusArray) -> None:
        """Release the plant when a plan has begun, even one that begins with controls of zero."""
        if any(goal.status == GoalStatus.STATUS_EXECUTING for goal in message.status_list):
            node.advance()
            node.simulation.released = True

    def drawn(given: Any) -> StatedView:
        view = StatedView(problem_of(problem, given))
        view.check_drawing()
        return view

    node.create_subscription(GoalStatusArray, TOPIC, on_tracker_status, LATCHED)
    parameters = with_parameters_of(_with_states(problem), problem, besides=('solver',))
    return PlantModel(parameters, kind, setup, push, drawn)


def _model_of(node: PlantNode) -> PlantModel:
    name = str(node.parameter_values[PROBLEM.name])
    built_in = {'pendulum_swing_up': PENDULUM_MODEL, 'robot_formation': ROBOT_MODEL}
    return built_in.get(name) or _stated_model(stated_problem(name), node)


StatedPlant = partial(PlantNode, 'plant', _model_of, {PROBLEM.name: PROBLEM})
main = partial(run, StatedPlant)

if __name__ == '__main__':
    sys.exit(main())
