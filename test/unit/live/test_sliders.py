# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Sliders from what nodes say of their parameters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from tdm_sim.live.sliders import in_order, shown_range, slider_of


def descriptor(name: str, kind: int = 3, **more: Any) -> Any:
    declared = {
        'name': name,
        'type': kind,
        'description': 'largest torque [N m]',
        'additional_constraints': 'must be in [1e-12, 1e+12] N m',
        'read_only': False,
        'floating_point_range': [SimpleNamespace(from_value=0.0, to_value=1e12)],
        'integer_range': [SimpleNamespace(from_value=1, to_value=1000)],
    }
    return SimpleNamespace(**(declared | more))


def test_range_unit_and_description_come_from_the_declaration() -> None:
    found = slider_of(descriptor('limits.torque'), 0.02)
    assert found is not None
    assert (found.low, found.high) == pytest.approx((0.005, 0.08))
    assert (found.unit, found.group, found.value) == ('N m', 'limits', 0.02)
    assert found.hint == 'limits.torque: largest torque. must be in [1e-12, 1e+12] N m'
    share = slider_of(
        descriptor(
            'torque_reserve',
            description='share for the feedback',
            floating_point_range=[SimpleNamespace(from_value=0.0, to_value=1.0)],
        ),
        0.3,
    )
    assert share is not None
    assert (share.low, share.high, share.unit, share.group) == (0.0, 1.0, '', '')
    whole = slider_of(descriptor('switching_arcs', 2), 256)
    assert whole is not None
    assert all(isinstance(v, int) for v in (whole.low, whole.high, whole.step, whole.value))


@pytest.mark.parametrize(
    ('name', 'more', 'value'),
    [
        ('method', {'kind': 4}, 'switching'),
        ('start.delay', {}, 1.0),
        ('solver.deadline', {}, 0.5),
        ('replan.rate', {}, 0.0),
        ('limits.torque', {'read_only': True}, 0.02),
        ('goal.turns', {'kind': 2}, None),
    ],
)
def test_what_has_no_slider(name: str, more: dict[str, Any], value: Any) -> None:
    assert slider_of(descriptor(name, **more), value) is None


@given(st.floats(-1e6, 1e6), st.floats(-1e12, 1e12), st.floats(-1e12, 1e12))
def test_a_slider_holds_its_value_and_keeps_to_what_is_allowed(
    value: float, one: float, other: float
) -> None:
    low, high = min(one, other, value), max(one, other, value)
    below, above = shown_range(value, low, high)
    assert low <= below <= value <= above <= high


def test_limits_and_weights_come_first() -> None:
    names = ('plant.mass', 'arena.length', 'weights.gas', 'limits.thrust', 'arrival_interval')
    sliders = [slider_of(descriptor(name), 1.0) for name in names]
    order = list(in_order(slider for slider in sliders if slider is not None))
    assert order[:2] == ['limits', 'weights']
    assert order[-1] == 'plant'
