# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Many plans over ranges of parameters, on all cores or on a Dask cluster: ``tdm study``."""

import tdm_sim  # noqa: F401  first: see tdm_planner.starting
from tdm_sim.study.axes import Axis, parse_axis
from tdm_sim.study.flights import ClosedLoop, fly
from tdm_sim.study.study import run
from tdm_sim.study.workers import each, workers

__all__ = ['Axis', 'ClosedLoop', 'each', 'fly', 'parse_axis', 'run', 'workers']
