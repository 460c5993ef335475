# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The rotary pendulum's swing-up: by switching times, or as a stated problem."""
