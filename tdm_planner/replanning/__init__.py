# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The plants as a planner knows them, reports on plans, and replanning on the way without a jump.

No ROS, no clock: instants are seconds of one clock, which the caller reads.
"""
