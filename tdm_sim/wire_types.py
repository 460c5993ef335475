# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Message types and qualities of service on the wire, in the terms of rclpy and rosbags."""

from __future__ import annotations

from functools import cache
import importlib
from pathlib import Path
import sys
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.resources import ament_prefixes

# Quality of service that every publisher's offer matches, as strong as all of them allow; deep
# enough for a burst that arrives while a chunk is written to disk.
AS_OFFERED = QoSProfile(
    depth=1000,
    reliability=ReliabilityPolicy.BEST_AVAILABLE,
    durability=DurabilityPolicy.BEST_AVAILABLE,
)


def message_class(type_name: str) -> Any:
    """
    Return the Python class of a message type such as ``sensor_msgs/msg/JointState``.

    Raises
    ------
    InvalidProblem
        If the package of the type is not installed.

    """
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise InvalidProblem(f"its message type '{type_name}' is not installed here") from None


def offered_profile(profile: QoSProfile) -> Any:
    """Return a publisher's offer as `rosbags` writes it."""

    def time(duration: Any) -> Any:
        return QosTime(*divmod(duration.nanoseconds, 10**9))

    return Qos(
        history=QosHistory(int(profile.history)),
        depth=profile.depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=time(profile.deadline),
        lifespan=time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def definition_and_hash(type_name: str, wire_hash: Any) -> tuple[str, str]:
    """
    Return the definition of a message type, those of its members appended, and its type hash.

    Standard types come with `rosbags`; others, or those whose hash on the wire differs, are read
    from their package's share folder.

    Raises
    ------
    InvalidProblem
        If the definition of the type is not to be found.

    """
    on_wire = str(wire_hash) if getattr(wire_hash, 'version', 0) > 0 else ''
    store = _standard_types()
    if type_name not in store.fielddefs or on_wire not in ('', store.hash_rihs01(type_name)):
        store = installed_types(type_name)
    definition, _ = store.generate_msgdef(type_name, ros_version=2)
    return definition, on_wire or store.hash_rihs01(type_name)


@cache
def _standard_types() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)


def installed_types(type_name: str) -> Any:
    """Types read from the .msg files of the installed packages: `type_name` and its members."""
    store = get_typestore(Stores.EMPTY)
    wanted = [type_name]
    while wanted:
        name = wanted.pop()
        if name in store.fielddefs:
            continue
        found = get_types_from_msg(_definition_file(name).read_text(), name)
        store.register(found)
        wanted += _members(found[name])
    return store


def _members(definition: Any) -> list[str]:
    """Names of the message types that a definition of `rosbags` refers to."""
    names = []
    for _, (kind, detail) in definition[1]:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        if kind == Nodetype.NAME:
            names.append(detail)
    return names


def _definition_file(type_name: str) -> Path:
    package, _, name = type_name.partition('/msg/')
    file = Path('share', package, 'msg', f'{name}.msg')
    for prefix in (*ament_prefixes(package), Path(sys.prefix)):
        if (prefix / file).is_file():
            return prefix / file
    raise InvalidProblem(f"the definition of its message type '{type_name}' is not found")
