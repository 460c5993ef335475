# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Quality of service that publishers and subscribers must agree on."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# A late subscriber gets what is active.
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
