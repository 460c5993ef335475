# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Six nodes on a hostile network: every kind once, in an empty home, in the namespaces of the policy.

`SixNodes.endure` does whatever a participant of the network may do, with the types that the nodes
themselves announce; afterwards they serve as if nothing had been. test/ros/test_hostile_network.py
has few cases, test/nightly/fuzz/test_inputs.py many new ones.
"""

from contextlib import suppress
import itertools
import json
import math
from typing import Any

import fuzz_inputs as fuzz
from fuzz_inputs import message, message_type, messages, SPECIFICATIONS, texts
from fuzzing import tried
from hypothesis import strategies as st
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
import rclpy.parameter
from ros_harness import PATIENCE
from stepped_ros import NodeHere, Stepped
from tdm_planner.exceptions import ERRORS
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.problems.planner_parameters import PlannerParameters
from tdm_sim.pendulum_plant import PendulumPlantParameters
from tdm_sim.robot_plant import RobotPlantParameters
from tools.node_tables import tracker_specifications

START = {'start.source': 'parameters', 'solver.deadline': 0.1, 'replan.rate': 1.0}
REQUEST = specifications(PlannerParameters)
# Their parameters, and the declarations of all.
NODES: dict[str, tuple[dict[str, Any], dict[str, ParameterSpec]]] = {
    '/pendulum/planner': (START, {**REQUEST, **SPECIFICATIONS['pendulum_swing_up']}),
    '/pendulum/tracker': ({}, tracker_specifications('pendulum')),
    '/pendulum/pendulum_plant': ({}, specifications(PendulumPlantParameters)),
    '/robots/planner': ({'problem': 'robot_formation', **START},
                        {**REQUEST, **SPECIFICATIONS['robot_formation']}),
    '/robots/robot1/tracker': ({'kind': 'robot', 'planner_service': '/robots/plan'},
                               tracker_specifications('robot')),
    # as robot1 starts
    '/robots/robot1/robot_plant': ({'initial.x': 0.6, 'initial.y': 0.7},
                                   specifications(RobotPlantParameters)),
}  # fmt: skip
NEVER_SET = ('solver.deadline', 'robot_name')  # what is asked for is kept: tests wait for it
SPACES = {'/pendulum': '/pendulum', '/robots': '/robots/robot1'}  # of planners, of their plants
ACTIONS = ['message'] * 5 + ['parameters'] * 4 + ['plan', 'plan_with'] * 2
ACTIONS += ['push', 'reset', 'transition', 'restart']

# Messages that reach further than any of their types would.
SHAPED: dict[str, st.SearchStrategy[Any]] = {
    'trajectory_msgs/JointTrajectory': st.one_of(
        fuzz.plans('JointTrajectory'), fuzz.quiet_plans('pendulum'), fuzz.quiet_plans('robot')
    ),
}
# What an active node can do is 4 (deactivate) and 7 (shut down), by number or else by name.
transitions = st.integers(0, 255).filter(lambda n: n not in (4, 7)) | st.builds(
    dict,
    id=st.sampled_from([0, 4, 7]),
    label=(texts | st.sampled_from(['configure', 'Deactivate', ' deactivate'])).filter(bool),
)
VALUE = 'rcl_interfaces/ParameterValue'
CODES = {error.code for error in ERRORS}
values = st.deferred(lambda: messages(message_type(VALUE), type=st.integers(0, 12)))


def sendable(text: str) -> str:
    return text.replace('\x00', '').encode('utf-8', 'ignore').decode()


@st.composite
def parameters(draw: Any, node: str) -> list[Parameter]:
    """Draw parameters to be set: values right and wrong, of the type they claim or another."""
    found = []
    for name, value in draw(fuzz.parameter_sets(NODES[node][1])).items():
        made = Parameter()
        with suppress(AssertionError, AttributeError, OverflowError, TypeError, ValueError):
            made = rclpy.parameter.Parameter('name', value=value).to_parameter_msg()
        made.name = sendable(name)
        made.value.integer_value = max(-(2**63), min(made.value.integer_value, 2**63 - 1))
        made.value.string_value = sendable(made.value.string_value)
        made.value.string_array_value = list(map(sendable, made.value.string_array_value))
        found.append(made)
    odd = [*NODES[node][1], 'use_sim_time_', '', 'qos_overrides.a', 'start', '.', fuzz.FORGED]
    for name in draw(st.lists(st.sampled_from(odd), max_size=3)):
        found.append(Parameter(name=name, value=message(VALUE, draw(values))))
    return [item for item in found if item.name not in NEVER_SET]


class SixNodes:
    """The nodes of `NODES`, and what is done to them."""

    def __init__(self, ros: Stepped) -> None:
        self.ros, self.nodes = ros, dict[str, NodeHere]()
        for path, (values, _) in NODES.items():
            namespace, _, name = path.rpartition('/')
            self.nodes[path] = ros.start(name, values, namespace)
        self._publishers: dict[str, tuple[str, Any]] = {}

    def check(self) -> None:
        for _, text in self.ros.log:
            assert 'Traceback' not in text
            assert not any(line.startswith('[ERROR] [1.0]') for line in text.splitlines()), text
        self.ros.log.clear()

    def meet(self) -> None:
        """Make a publisher for every topic that a node subscribes, with the type it names."""
        subscribed = self.ros.node.get_subscriber_names_and_types_by_node
        for path in NODES:
            self.set_items(path, [])  # so that it is there
            namespace, _, name = path.rpartition('/')
            for topic, (kind, *_) in subscribed(name, namespace):
                if topic not in ('/clock', '/parameter_events', *self._publishers):
                    kind = kind.replace('/msg/', '/')
                    publisher = self.ros.node.create_publisher(message_type(kind), topic, LATCHED)
                    self._publishers[topic] = kind, publisher

    def endure(self, cases: int, *, new: bool = False) -> None:
        self.meet()
        tried(st.data(), lambda data: self.suffer(data.draw), cases, new=new)
        self.recover()

    def suffer(self, draw: Any) -> None:
        action = draw(st.sampled_from(ACTIONS))
        space = draw(st.sampled_from(sorted(SPACES)))
        if action == 'message':
            topic = draw(st.sampled_from(sorted(self._publishers)))
            kind, publisher = self._publishers[topic]
            made = SHAPED[kind] if kind in SHAPED else messages(message_type(kind))
            for value in draw(st.lists(made, min_size=1, max_size=3)):
                publisher.publish(message(kind, value))
            self.ros.spin_for(0.01)
        elif action == 'parameters':
            node = draw(st.sampled_from(sorted(NODES)))
            self.set_items(node, draw(parameters(node)), draw(st.booleans()))
        elif action.startswith('plan'):
            own = parameters(f'{space}/planner') if action == 'plan_with' else st.none()
            self.plan(space, draw(own))
        elif action == 'transition':
            assert not self.ros.change(f'{space}/planner', draw(transitions))
        elif action == 'restart':  # with whatever latched topics hold
            for number in (4, 2, 1, 3):
                assert self.ros.change(f'{space}/planner', number), number
        else:
            assert self.ros.call(f'{SPACES[space]}/{action}').success
        self.check()

    def set_items(self, node: str, items: list[Parameter], atomically: bool = False) -> list[Any]:
        """Set parameters; what is not set has a reason, which is not the node's own error."""
        if atomically:
            results = [self.ros.set_all(f'{node}/set_parameters_atomically', *items)]
        else:
            request = SetParameters.Request(parameters=items)
            results = self.ros.call(f'{node}/set_parameters', SetParameters, request).results
            assert len(results) == len(items)
        for result in results:
            assert bool(result.reason) != result.successful, result
            assert 'INTERNAL' not in result.reason, (items, result.reason)
            assert '\n' not in result.reason
        return results

    def plan(self, space: str, items: list[Parameter] | None = None) -> bool:
        """Ask for a plan, with parameters of its own if given; a refusal has its reason."""
        if items is None:
            fine, answer = self.ros.trigger(f'{space}/plan')
        else:
            result = self.ros.set_all(f'{space}/plan_with', *items)
            fine, answer = result.successful, json.loads(result.reason)
        assert fine or answer['code'] in CODES - {'INTERNAL'}, (items, answer)
        assert fine or 'INTERNAL' not in answer['reason'], (items, answer)
        return bool(fine)

    def refuse_types_that_do_not_exist(self) -> None:
        """They once ended every node: rclpy raises out of the callback."""
        for node, kind, atomically in itertools.product(NODES, (10, 255), (False, True)):
            item = Parameter(name='mass', value=ParameterValue(type=kind))
            (result,) = self.set_items(node, [item], atomically)
            assert not result.successful

    def recover(self) -> None:
        """With the defaults set again, plans are made and followed, all numbers are finite."""
        for _, publisher in self._publishers.values():
            self.ros.node.destroy_publisher(publisher)
        self._publishers.clear()
        for node, (values, specs) in NODES.items():
            free = [n for n, spec in specs.items() if not spec.read_only and n not in NEVER_SET]
            wanted = {name: values.get(name, specs[name].default) for name in free}
            for _ in range(2):  # values that depend on one another
                refused = [r for r in self.ros.set_parameters(node, wanted) if r]
            assert not refused, refused
        for planner, plant in SPACES.items():
            self.ros.set_parameters(f'{planner}/planner', solver__deadline=PATIENCE)
            states = self.ros.subscribe(f'{plant}/joint_states')
            commands = self.ros.subscribe(f'{plant}/joint_command')

            def moved(planner: str = planner, plant: str = plant, states: Any = states) -> bool:
                assert self.ros.call(f'{plant}/reset').success
                assert self.plan(planner)
                return self.ros.spin_until(lambda: any(any(s.effort) for s in states), 3.0)

            assert self.ros.spin_until(moved, PATIENCE), self.nodes[f'{plant}/tracker'].output
            for item in [*states[-100:], *commands[-100:]]:
                assert all(map(math.isfinite, [*item.position, *item.velocity, *item.effort]))
        self.check()
