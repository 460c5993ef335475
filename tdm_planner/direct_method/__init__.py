# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The direct method itself, free of any plant: sections 2 and 3 of Yakimenko (2006)."""

from typing import Any, TYPE_CHECKING

from tdm_planner.direct_method.formulation import Duration, Formulation, Integrated, Output
from tdm_planner.direct_method.nonlinear_program import (
    Budget,
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.polynomial import PolynomialBasis, PolynomialReference
from tdm_planner.direct_method.reference_function import ReferenceBasis, ReferenceFunction
from tdm_planner.direct_method.shapes import (
    CombinedShapes,
    power_products,
    PowerProducts,
    Shapes,
    SineSeries,
    symmetric_powers,
)
from tdm_planner.direct_method.taranenko import TaranenkoBasis, TaranenkoReference
from tdm_planner.direct_method.trust_region import minimise, Minimum, TrustRegionOptions
from tdm_planner.direct_method.virtual_domain import arc_derivatives, time_derivatives

if TYPE_CHECKING:
    from tdm_planner.direct_method.transcription import Transcription

__all__ = [
    'Budget',
    'CombinedShapes',
    'Duration',
    'Formulation',
    'Integrated',
    'Linearisation',
    'Minimum',
    'Multipliers',
    'NonlinearProgram',
    'Output',
    'Point',
    'PolynomialBasis',
    'PolynomialReference',
    'PowerProducts',
    'ReferenceBasis',
    'ReferenceFunction',
    'Shapes',
    'SineSeries',
    'TaranenkoBasis',
    'TaranenkoReference',
    'Transcription',
    'TrustRegionOptions',
    'arc_derivatives',
    'minimise',
    'power_products',
    'symmetric_powers',
    'time_derivatives',
]


def __getattr__(name: str) -> Any:
    """Import what traces, which takes CasADi, when it is used."""
    if name == 'Transcription':
        from tdm_planner.direct_method.transcription import Transcription

        return Transcription
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
