# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""To be written."""
