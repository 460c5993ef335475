# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service that publishers and subscribers must agree on."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# A late subscriber gets what is in force.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

# States and commands: the newest counts, and a lost one is not waited for. A reliable subscriber
# would hold back those behind it until it is sent again: over a link that delays by 20 ms, another
# 15 ms, and up to 150. Subscribed like this, publishers of either kind fit.
NEWEST = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)

# Requests and answers of a service that many may call at once. Of the usual ten, the oldest would
# be overwritten while the node is busy, and whoever sent it would wait for ever.
SERVICE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
