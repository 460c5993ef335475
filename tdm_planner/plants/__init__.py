# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Plants: equations of motion in time, vectorised, with units and derivatives."""
