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

# A late subscriber gets the active plan or status.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

# States and commands: only the newest counts. A reliable subscriber would hold messages back until
# a lost one is sent again: over a link of 20 ms, for another 15 to 150 ms. Best effort matches
# publishers of either kind.
NEWEST = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)

# Requests and answers of a service that many may call at once. Of the usual ten, the oldest would
# be overwritten while the node is busy, and whoever sent it would wait for ever.
SERVICE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
