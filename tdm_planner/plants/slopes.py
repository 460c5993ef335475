# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives of what is stated of a plant, taken by CasADi and written down as plain Python.

It is stated once, as a function of numbers: numba compiles it as it stands, CasADi traces it,
numpy calls it with arrays. What is written here serves numba and numpy alike. The text
is kept where the kernels are, so that CasADi is imported once for every version of the sources.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
import inspect
import os
from pathlib import Path
import re
import sys
from typing import Any

import numpy as np

_MARK = re.compile(rb'@compiled|SymbolicPlant|def equations\(|with_slopes')  # of what matters
_NAMED = re.compile(rb'tdm_planner((?:\.\w+)+)')


def _sources(package: Path) -> list[bytes]:
    """Return what kernels depend on; a file of an earlier version that nothing names is stale."""
    read: dict[Path, bytes] = {}
    found = {package / 'problems' / 'registry.py', package / 'tracking' / '__init__.py'}
    while found:
        read |= {path: path.read_bytes() for path in found}
        named = {name.decode() for path in found for name in _NAMED.findall(read[path])}
        modules = {package.joinpath(*name.split('.')[1:]) for name in named}
        paths = {path.with_suffix('.py') for path in modules} | {
            path / '__init__.py' for path in modules
        }
        found = {path for path in paths if path not in read and path.is_file()}
    return [read[path] for path in sorted(read) if _MARK.search(read[path])]


DIGEST = sha256(b''.join(_sources(Path(__file__).parents[1]))).hexdigest()[:16]
FOLDER = Path(
    os.environ.get('NUMBA_CACHE_DIR', Path(sys.prefix, 'share')), 'tdm_planner', 'kernels', DIGEST
)
with suppress(OSError):  # then numba's own folder will do
    FOLDER.mkdir(mode=0o755, parents=True, exist_ok=True)

_OPERATIONS = {
    'ADD': '{} + {}', 'SUB': '{} - {}', 'MUL': '{} * {}', 'DIV': '{} * (1.0 / {})', 'NEG': '-{}',
    'SQ': '{0} * {0}', 'TWICE': '2.0 * {}', 'INV': '1.0 / {}', 'SIN': 'sin({})', 'COS': 'cos({})',
    'SQRT': 'sqrt({})', 'FABS': 'abs({})', 'SIGN': 'sign({})',
}  # fmt: skip


@cache
def with_slopes(
    function: Callable[..., tuple[Any, ...]],
    by: tuple[str, ...],
    sin: Callable[[Any], Any] = np.sin,
    cos: Callable[[Any], Any] = np.cos,
    curved: bool = False,
    **parts: Any,
) -> Callable[..., Any]:
    """
    Return a function of the same arguments: all values, all derived by the first of `by`, ...

    `function`, one of this package, calls numpy's functions on numbers and returns a tuple of
    them; `sin` and `cos` are what the new one calls. `parts` tells the arguments that are
    sequences: their length, or the type of a named tuple.

    A `curved` one takes two more arguments, a weight and an array. It writes into the array what
    it else returns, then the Hessian of the first value times the weight.
    """
    kind = 'curvature' if curved else 'slopes'
    file = FOLDER / f'{function.__module__}.{function.__qualname__}.{".".join(by)}.{kind}.py'
    try:
        text = file.read_text()
    except OSError:
        text = _text(function, by, curved, parts)
        with suppress(OSError):  # another user has set the environment up
            part = file.with_suffix(f'.{os.getpid()}')
            part.write_text(text)
            part.replace(file)
    made: dict[str, Any] = {'sin': sin, 'cos': cos, 'sqrt': np.sqrt, 'sign': np.sign}
    exec(compile(text, __file__, 'exec'), made)  # noqa: S102 - what CasADi wrote of a function
    written: Callable[..., Any] = made['written']
    return written


def _text(
    function: Callable[..., Any], by: tuple[str, ...], curved: bool, parts: dict[str, Any]
) -> str:
    import casadi

    casadi.GlobalOptions.setNumpyMode(-1)  # numpy's functions of symbols give symbols
    arguments: dict[str, Any] = {}
    symbols: dict[str, list[Any]] = {}
    for name in inspect.signature(function).parameters:
        kind = parts.get(name)
        if kind is None:
            arguments[name] = casadi.SX.sym(name)
            symbols[name] = [arguments[name]]
        else:
            count = kind if isinstance(kind, int) else len(kind._fields)
            symbols[name] = [casadi.SX.sym(f'{name}[{i}]') for i in range(count)]
            arguments[name] = symbols[name] if count == kind else kind(*symbols[name])
    values = casadi.vertcat(*function(*arguments.values()))
    varied = casadi.vertcat(*(part for name in by for part in symbols[name]))
    results = [values, casadi.jacobian(values, varied)]
    if curved:
        weight = casadi.SX.sym('weight')
        results.append(casadi.hessian(weight * values[0], varied)[0])
        symbols['weight'], symbols['result'] = [weight], []
    inputs = [symbol for several in symbols.values() for symbol in several]
    results = casadi.cse(casadi.densify(casadi.veccat(*results)))
    graph = casadi.Function('graph', inputs, [results])
    templates = {getattr(casadi, f'OP_{name}'): form for name, form in _OPERATIONS.items()}
    lines, place = [], 'result[{}]' if curved else 'r{}'
    for i in range(graph.n_instructions()):
        operation, to = graph.instruction_id(i), graph.instruction_output(i)
        operands = graph.instruction_input(i)
        if operation == casadi.OP_OUTPUT:
            lines.append(f'{place.format(to[1])} = w{operands[0]}')
        elif operation == casadi.OP_INPUT:
            lines.append(f'w{to[0]} = {inputs[operands[0]].name()}')
        elif operation == casadi.OP_CONST:
            lines.append(f'w{to[0]} = {graph.instruction_constant(i)!r}')
        else:
            terms = templates[operation].format(*(f'w{operand}' for operand in operands))
            lines.append(f'w{to[0]} = {terms}')
    if not curved:
        lines.append(f'return {" ".join(f"r{i}," for i in range(graph.numel_out(0)))}')
    return '\n    '.join([f'def written({", ".join(symbols)}):', *lines]) + '\n'
