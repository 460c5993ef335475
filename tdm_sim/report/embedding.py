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

"""
Data inside a page: safe in HTML whatever a recording holds, and small.

Numbers are written as plotly.js reads typed arrays, ``{"dtype": "f4", "bdata": base64}``, which
takes a third of the room of digits. Names and texts come from files that anybody may have written:
no string can end the element that holds the data.
"""

from __future__ import annotations

import base64
import hashlib
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# Within a JSON string these mean the same as the characters; in HTML they mean nothing.
_ESCAPES = {'<': r'\u003c', '>': r'\u003e', '&': r'\u0026'}


def packed(values: ArrayLike) -> dict[str, str]:
    """Return numbers (n,) in single precision as plotly.js reads them; NaN is a gap."""
    data = np.ascontiguousarray(values, dtype='<f4').tobytes()
    return {'dtype': 'f4', 'bdata': base64.b64encode(data).decode('ascii')}


def unpacked(data: dict[str, str]) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Inverse of `packed`."""
    return np.frombuffer(base64.b64decode(data['bdata']), dtype='<f4')


def json_for_html(data: Any) -> str:
    """
    Return `data` as JSON that may stand inside a ``<script>`` element.

    Raises
    ------
    ValueError
        For a number that is not finite, which JSON cannot hold.

    """
    text = json.dumps(data, allow_nan=False, separators=(',', ':'))
    for character, escape in _ESCAPES.items():
        text = text.replace(character, escape)
    return text


def content_hash(script: str) -> str:
    """Return the source expression by which a content security policy lets a script run."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
