# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
ROS 2 messages as DDS sees them, written down from their definitions, and the names on the wire.

A message `pkg/msg/Name` is the DDS type `pkg::msg::dds_::Name_`. A topic `/a/b` is `rt/a/b`; a
service `/a/b` is a pair of topics, `rq/a/bRequest` and `rr/a/bReply`. Members are in the order of
the definition, which is all that the encoding depends on.
"""

# mypy: disable-error-code="call-arg"

from dataclasses import dataclass, field

from cyclonedds.idl import IdlStruct, types


def topic_name(topic: str) -> str:
    return f'rt/{topic.strip("/")}'


def request_name(service: str) -> str:
    return f'rq/{service.strip("/")}Request'


def reply_name(service: str) -> str:
    return f'rr/{service.strip("/")}Reply'


@dataclass
class Time(IdlStruct, typename='builtin_interfaces::msg::dds_::Time_'):
    sec: types.int32
    nanosec: types.uint32

    @property
    def nanoseconds(self) -> int:
        return int(self.sec) * 1_000_000_000 + int(self.nanosec)


@dataclass
class Duration(IdlStruct, typename='builtin_interfaces::msg::dds_::Duration_'):
    sec: types.int32
    nanosec: types.uint32

    @property
    def nanoseconds(self) -> int:
        return int(self.sec) * 1_000_000_000 + int(self.nanosec)


@dataclass
class Header(IdlStruct, typename='std_msgs::msg::dds_::Header_'):
    stamp: Time
    frame_id: str


@dataclass
class JointTrajectoryPoint(
    IdlStruct, typename='trajectory_msgs::msg::dds_::JointTrajectoryPoint_'
):
    positions: types.sequence[types.float64]
    velocities: types.sequence[types.float64]
    accelerations: types.sequence[types.float64]
    effort: types.sequence[types.float64]
    time_from_start: Duration


@dataclass
class JointTrajectory(IdlStruct, typename='trajectory_msgs::msg::dds_::JointTrajectory_'):
    header: Header
    joint_names: types.sequence[str]
    points: types.sequence[JointTrajectoryPoint]


@dataclass
class JointState(IdlStruct, typename='sensor_msgs::msg::dds_::JointState_'):
    header: Header
    name: types.sequence[str]
    position: types.sequence[types.float64]
    velocity: types.sequence[types.float64]
    effort: types.sequence[types.float64]


@dataclass
class KeyValue(IdlStruct, typename='diagnostic_msgs::msg::dds_::KeyValue_'):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename='diagnostic_msgs::msg::dds_::DiagnosticStatus_'):
    level: types.byte
    name: str
    message: str
    hardware_id: str
    values: types.sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename='diagnostic_msgs::msg::dds_::DiagnosticArray_'):
    header: Header
    status: types.sequence[DiagnosticStatus]


@dataclass
class TriggerRequest(IdlStruct, typename='std_srvs::srv::dds_::Trigger_Request_'):
    structure_needs_at_least_one_member: types.uint8 = 0


@dataclass
class TriggerReply(IdlStruct, typename='std_srvs::srv::dds_::Trigger_Response_'):
    success: bool = False
    message: str = field(default='')
