# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service that publishers and subscribers must agree on."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# A late subscriber gets what is in force.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
