# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The graphs of one node of a transcription, from the traced functions of the statement."""

from __future__ import annotations

import casadi as ca
from tdm_planner.direct_method.arc_basis import ArcLayout
from tdm_planner.direct_method.checked_formulation import CheckedFormulation
from tdm_planner.direct_method.graphs import Differentiated
from tdm_planner.direct_method.tracing import Trace


class NodeGraphs:
    """
    The graphs of a node: from w (see `ArcBasis`) and the integrated states z to all values.

    `motion` gives states and controls, `node` the integrand of J by s and the margins, `start`
    and `end` the conditions there (`end` after the final cost), `step` a Runge-Kutta step of z.
    """

    def __init__(self, trace: Trace, layout: ArcLayout, stated: CheckedFormulation) -> None:
        names = list(stated.integrated())
        w, z = ca.SX.sym('w', layout.size), ca.SX.sym('z', len(names))
        p = ca.SX.sym('p', trace.invert.numel_in(2))
        mu, t, y = layout.read(w)
        wz = ca.vertcat(w, z)
        jets = ca.vertcat(*(value for jet in y.values() for value in jet))
        both = trace.invert(jets, z, p)
        x, u = ca.vertsplit(both, [0, len(stated.state_names), both.numel()])
        self.motion = ca.Function('motion', [wz, p], [both])
        rows = ca.vertcat(trace.running(t, x, u, p) * mu, trace.margins(t, x, u, p))
        ends = ca.vertcat(trace.final(t, x, p), trace.end_conditions(t, x, p))
        self.node = Differentiated('node', wz, p, rows)
        self.start = Differentiated('start', wz, p, trace.start_conditions(t, x, p))
        self.end = Differentiated('end', wz, p, ends)
        self.starts, self.ends = int(trace.start_conditions.numel_out()), int(ends.numel()) - 1
        if not names:
            return
        index = [stated.state_names.index(name) for name in names]
        rate = ca.Function('rate', [w, z, p], [trace.rates(x, u, p)[index] * mu])
        here, middle, there = (ca.SX.sym(name, layout.size) for name in 'amb')
        h = ca.SX.sym('h')
        k1 = rate(here, z, p)
        k2 = rate(middle, z + h / 2 * k1, p)
        k3 = rate(middle, z + h / 2 * k2, p)
        k4 = rate(there, z + h * k3, p)
        following = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        arguments = ca.vertcat(here, middle, there, z), ca.vertcat(p, h)
        self.step = Differentiated('step', *arguments, following)

    @classmethod
    def of(cls, trace: Trace, layout: ArcLayout, stated: CheckedFormulation) -> NodeGraphs:
        """Return the graphs of this kind, made once."""
        return trace.once(layout, lambda: cls(trace, layout, stated))
