# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Message types and qualities of service on the wire, in the terms of rclpy and rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import importlib
import os
from pathlib import Path
import sys
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from tdm_planner.exceptions import InvalidProblem

# Deep enough for a burst that arrives while a chunk is written to disk.
_DEPTH = 1000


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


def subscription_profile(offered: Sequence[QoSProfile]) -> QoSProfile:
    """Quality of service that every publisher's offer matches, as strong as all of them allow."""
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in offered)
    durable = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE,
    )


def offered_profile(profile: QoSProfile) -> Any:
    """Return a publisher's offer as `rosbags` writes it."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

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
    from rosbags.typesys import get_typestore, Stores

    return get_typestore(Stores.ROS2_JAZZY)


def installed_types(type_name: str) -> Any:
    """Types read from the .msg files of the installed packages: `type_name` and its members."""
    from rosbags.typesys import get_types_from_msg, get_typestore, Stores

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
    from rosbags.interfaces import Nodetype

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
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in prefixes:
        if prefix and (found := Path(prefix) / file).is_file():
            return found
    raise InvalidProblem(f"the definition of its message type '{type_name}' is not found")
