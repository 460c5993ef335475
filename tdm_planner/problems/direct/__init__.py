# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A problem that is stated: `DirectProblem`, its search by the direct method and collocation."""

from tdm_planner.problems.direct.problem import DirectProblem

__all__ = ['DirectProblem']
