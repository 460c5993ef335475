# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What of rclpy's own the managed nodes rely on, so that a new rclpy says what is missing."""

from __future__ import annotations

from collections.abc import Iterator

from lifecycle_msgs.msg import Transition
import pytest
import rclpy
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode
from ros_harness import Ros

MENDED = 'tdm_planner/nodes/managed.py relies on it: look there what this rclpy has instead'


@pytest.fixture
def node(ros: Ros) -> Iterator[LifecycleNode]:
    """Yield a managed node of rclpy's own, unconfigured."""
    context = Context()
    rclpy.init(context=context, domain_id=ros.domain)
    made = LifecycleNode('managed_by_rclpy', context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def test_the_service_of_transitions_has_a_callback_that_can_be_exchanged(
    node: LifecycleNode,
) -> None:
    service = getattr(node, '_service_change_state', None)
    assert service is not None, f'no _service_change_state: {MENDED}'
    assert service.srv_name.endswith('change_state')
    assert service in list(node.services), f'services has it not: {MENDED}'
    assert callable(getattr(service, 'callback', None)), f'its callback is none: {MENDED}'

    def mine(request: object, response: object) -> object:
        return response

    service.callback = mine
    assert service.callback is mine, f'its callback cannot be exchanged: {MENDED}'


def test_the_state_machine_tells_possible_transitions_by_number_and_label(
    node: LifecycleNode,
) -> None:
    machine = getattr(node, '_state_machine', None)
    assert machine is not None, f'no _state_machine: {MENDED}'
    possible = getattr(machine, 'available_transitions', None)
    assert possible is not None, f'no _state_machine.available_transitions: {MENDED}'
    found = {transition[0]: transition[1] for transition in possible}
    assert found == {
        Transition.TRANSITION_CONFIGURE: 'configure',
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: 'shutdown',
    }, MENDED
