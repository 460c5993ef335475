# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated plants, demos, recordings, reports and studies."""

import tdm_planner  # noqa: F401  first: see tdm_planner.starting
