# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Declared parameters (`tdm_planner.parameters`) as ROS parameters.

A wrong value gets one clear sentence, be it from the command line, a file or a service.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import groupby
import math
from typing import Any, get_origin

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from tdm_planner.exceptions import Failure, InvalidProblem, one_line
from tdm_planner.nodes.services import answer_malformed_requests, answer_reliably
from tdm_planner.parameter_files import parse_yaml
from tdm_planner.parameters import ParameterSpec, suggestion
from yaml import YAMLError

_TYPES: Mapping[Any, Parameter.Type] = {
    float: Parameter.Type.DOUBLE,
    int: Parameter.Type.INTEGER,
    bool: Parameter.Type.BOOL,
    str: Parameter.Type.STRING,
    list[float]: Parameter.Type.DOUBLE_ARRAY,
    list[str]: Parameter.Type.STRING_ARRAY,
}
_INT64 = 2**63
_LONGEST_TEXT = 1000  # letters of a value that is read
WARNING_PERIOD = 2.0  # s, the least time between warnings of a kind


class ParameterNode(Node):
    """
    A node whose parameters are declared by `ParameterSpec`s.

    Integers are accepted as numbers, and text is parsed, see `typed`. An invalid value is rejected
    with the sentence of `ParameterSpec.check`; given at the start it ends the node.
    ``ros2 param delete`` or ``null`` unsets an optional parameter.

    Values pass rclpy's callbacks: pre-set gives them their declared type and checks each, on-set
    checks them against each other, post-set applies them.
    """

    def __init__(
        self, name: str, specifications: Mapping[str, ParameterSpec] | None = None, **options: Any
    ) -> None:
        self._specifications: dict[str, ParameterSpec] = {}
        self._values: dict[str, Any] = {}
        super().__init__(name, **options)
        for service in self.services:
            answer_malformed_requests(self, service)
        self._overrides = {
            key: item.value
            for key, item in self._parameter_overrides.items()
            if not _is_of_rclpy(key)
        }
        self.declare(specifications or {})
        self.add_pre_set_parameters_callback(self._as_declared)
        self.add_on_set_parameters_callback(self._check_together)
        self.add_post_set_parameters_callback(self._take)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """As rclpy's; drops simulated times that rclpy cannot hold."""

        def on_clock(message: Clock) -> None:
            if message.clock.sec >= 0:
                callback(message)
                return
            self.get_logger().warning(
                f'simulated time {message.clock.sec} s dropped: must not be negative',
                throttle_duration_sec=WARNING_PERIOD,
            )

        take = on_clock if msg_type is Clock else callback
        return super().create_subscription(msg_type, topic, take, *args, **kwargs)

    def create_service(self, *args: Any, **kwargs: Any) -> Any:
        """As rclpy's; responses also reach a client that was discovered only just now."""
        service = super().create_service(*args, **kwargs)
        answer_reliably(self, service)
        return service

    @property
    def parameter_values(self) -> dict[str, Any]:
        """Every declared parameter's value in its Python type; None where it is unset."""
        return dict(self._values)

    def declare(self, specifications: Mapping[str, ParameterSpec]) -> None:
        """
        Declare parameters, each with its value from the command line or file, or its default.

        Those already declared keep their value. Raise InvalidProblem for one that is not allowed.
        """
        for name, spec in specifications.items():
            if name not in self._specifications:
                self._declare(spec, self.initial_value(spec))

    def warn_of_unknown_overrides(self) -> None:
        """
        Log values given at the start for parameters that do not exist, with similar names.

        Those of a group that does not exist, such as a robot that does not take part, are told at
        once.
        """
        groups = {name.partition('.')[0] for name in self._specifications}
        unknown = sorted(self._overrides.keys() - self._specifications.keys())
        for group, names in groupby(unknown, lambda name: name.partition('.')[0]):
            several = list(names)
            told = several if group in groups else several[:1]
            more = len(several) - len(told)
            end = f", and {more} more of '{group}.*'" if more else ''
            for name in told:
                self.get_logger().warning(f'{self._unknown(name)}; the value is ignored{end}')

    def check_values(self, values: Mapping[str, Any]) -> None:
        """
        Check values against each other before they are set; to be overridden.

        Raise InvalidProblem to reject the change with its sentence.
        """

    def values_changed(self) -> None:
        """React to parameters that were set; to be overridden."""

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """
        Set all or none; the result's reason is one sentence, whatever goes wrong.

        A parameter that is fixed may be set to the value it has, as `ros2 param load` does.
        """
        try:
            changed = [item for item in parameter_list if not self._is_fixed_at(item)]
            if not changed:
                return SetParametersResult(successful=True)
            result = super().set_parameters_atomically(changed)
        except Exception as error:  # noqa: B902
            failure = Failure.of(error)
            if failure.trace:
                self.get_logger().error(failure.trace)
            result = SetParametersResult(successful=False, reason=failure.sentence)
        if not result.successful:
            self.get_logger().warning(f'rejected: {result.reason}')
        return result

    def checked(self, parameters: Iterable[Parameter]) -> dict[str, Any]:
        """
        Return values in their declared types by name, None where a parameter is to be unset.

        Raise InvalidProblem for a parameter that is unknown or fixed, or a value that is not
        allowed.
        """
        found = {}
        for item in parameters:
            spec = self._specifications.get(item.name)
            if spec is None:
                raise InvalidProblem(self._unknown(item.name))
            if spec.read_only:
                raise InvalidProblem(
                    f"parameter '{item.name}' = {item.value} is not allowed: it is fixed while "
                    'the node runs, give it when the node is started'
                )
            found[item.name] = spec.check(typed(spec, item.value))
        return found

    def _as_declared(self, parameters: list[Parameter]) -> list[Parameter]:
        undeclared = self._specifications.keys() - self._values.keys()
        if any(item.name in undeclared for item in parameters):
            return parameters  # being declared
        checked = self.checked(
            item
            for item in parameters
            if not (_is_of_rclpy(item.name) and self.has_parameter(item.name))
        )
        return [
            self._as_ros(item.name, checked[item.name]) if item.name in checked else item
            for item in parameters
        ]

    def _check_together(self, parameters: list[Parameter]) -> SetParametersResult:
        if changed := self._own(parameters):
            self.check_values({**self._values, **changed})
        return SetParametersResult(successful=True)

    def _take(self, parameters: list[Parameter]) -> None:
        changed = self._own(parameters)
        for name, value in changed.items():
            if value is None:  # rclpy has forgotten it
                self._declare(self._specifications[name], None)
            self._values[name] = value
        try:
            if changed:
                self.values_changed()
        except Exception as error:  # noqa: B902
            # The values are set; the next request reports the fault.
            sentence = f'{type(error).__name__}: {one_line(error)}'
            self.get_logger().error(f'parameters were set, but: {sentence}')

    def _own(self, parameters: list[Parameter]) -> dict[str, Any]:
        """Return the values of parameters that are set, without those still being declared."""
        return {item.name: item.value for item in parameters if item.name in self._values}

    def _is_fixed_at(self, item: Parameter) -> bool:
        """Whether it is read-only and keeps its value, which rclpy would reject."""
        if not self.has_parameter(item.name) or not self.describe_parameter(item.name).read_only:
            return False
        return bool(self.get_parameter(item.name).value == item.value)

    def initial_value(self, spec: ParameterSpec) -> Any:
        """Return the value given at the start, checked, or the default; raise InvalidProblem."""
        if spec.name not in self._overrides:
            return spec.default
        value = self._overrides[spec.name]
        if value is None and get_origin(spec.value_type) is list:
            value = []  # rcl hands an empty list over as a parameter that is not set
        return spec.check(typed(spec, value))

    def _declare(self, spec: ParameterSpec, value: Any) -> None:
        self._specifications[spec.name] = spec
        self._values.pop(spec.name, None)
        described = descriptor(spec)
        if isinstance(value, list) and not value:
            # An empty list says nothing of its type: declare the type first, then set it.
            self.declare_parameter(
                spec.name, _TYPES[spec.value_type], described, ignore_override=True
            )
            super().set_parameters_atomically([self._as_ros(spec.name, value)])
        else:
            self.declare_parameter(spec.name, value, described, ignore_override=True)
        self._values[spec.name] = value

    def _unknown(self, name: str) -> str:
        hint = suggestion(name, self._specifications) or 'it is not declared here'
        return f"parameter '{name}' is unknown: {hint}"

    def _as_ros(self, name: str, value: Any) -> Parameter:
        known = _TYPES[self._specifications[name].value_type]
        kind = Parameter.Type.NOT_SET if value is None else known
        return Parameter(name, kind, value)


def _is_of_rclpy(name: str) -> bool:
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )


def typed(spec: ParameterSpec, value: Any) -> Any:
    """
    Return the value that a text stands for, where a parameter is no string.

    The tools of ROS 2 read YAML 1.1, in which ``1e-8`` is a string. They pass as text what they
    have no type for: ``null``, and lists that mix numbers and integers. ``ros2 param load`` writes
    ``None`` for null.
    """
    if spec.value_type == list[float] and isinstance(value, list):
        number = replace(spec, value_type=float, optional=False)
        return [typed(number, item) for item in value]
    if spec.value_type is str or not isinstance(value, str) or len(value) > _LONGEST_TEXT:
        return value
    try:
        read = None if value == 'None' else parse_yaml(value)
    except YAMLError:
        return value
    return value if read is None and not spec.optional else read


def descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    """Return what ROS tools show of a parameter: description, unit, range, what is allowed."""
    unit = f' [{spec.unit}]' if spec.unit else ''
    described = ParameterDescriptor(
        name=spec.name,
        type=_TYPES[spec.value_type].value,
        description=spec.description + unit,
        additional_constraints=f'must be {spec.allowed}' + (', or unset' if spec.optional else ''),
        read_only=spec.read_only,
        dynamic_typing=spec.optional,
    )
    if spec.range.bounded and spec.value_type is float:
        described.floating_point_range = [
            FloatingPointRange(from_value=spec.range.lower, to_value=spec.range.upper)
        ]
    elif spec.range.bounded and spec.value_type is int:
        lower = math.ceil(max(spec.range.lower, -_INT64))
        upper = min(math.floor(min(spec.range.upper, _INT64)), _INT64 - 1)
        lower += spec.range.lower_open and lower == spec.range.lower
        upper -= spec.range.upper_open and upper == spec.range.upper
        step = spec.range.step or 1
        described.integer_range = [IntegerRange(from_value=lower, to_value=upper, step=step)]
    return described
