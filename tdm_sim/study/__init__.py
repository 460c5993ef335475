# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Many plans over ranges of parameters, on all cores or on a Dask cluster: ``tdm study``."""

import tdm_sim  # noqa: F401  first: see tdm_planner.starting
from tdm_sim.study.axes import Axis, parse_axis
from tdm_sim.study.flights import ClosedLoop, fly
from tdm_sim.study.study import run
from tdm_sim.study.workers import each, workers

__all__ = ['Axis', 'ClosedLoop', 'each', 'fly', 'parse_axis', 'run', 'workers']
