# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A report on a mission, read from a recording or a plan."""
