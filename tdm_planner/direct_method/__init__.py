# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The direct method itself, free of any plant: sections 2 and 3 of Yakimenko (2006)."""

from tdm_planner.direct_method.formulation import (
    Duration,
    Formulation,
    Integrated,
    Output,
    PowerProducts,
    Shapes,
    SineSeries,
    symmetric_powers,
)
from tdm_planner.direct_method.nonlinear_program import Budget

__all__ = [
    'Budget',
    'Duration',
    'Formulation',
    'Integrated',
    'Output',
    'PowerProducts',
    'Shapes',
    'SineSeries',
    'symmetric_powers',
]
