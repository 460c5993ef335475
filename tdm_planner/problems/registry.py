# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Problems by name: those of the package, and those that other packages register.

A package registers a problem under the entry-point group `tdm_planner.problems`, in its setup.cfg:

    [options.entry_points]
    tdm_planner.problems =
        my_problem = my_package.my_module:MyProblem
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
import os
from pathlib import Path
import re
import sys
from typing import Any

from tdm_planner.exceptions import InvalidProblem, one_line, place_of
from tdm_planner.parameters import suggestion
from tdm_planner.problems.problem import Problem

GROUP = _HERE = 'tdm_planner.problems'
SHORT_NAMES = {'pendulum': 'pendulum_swing_up', 'robots': 'robot_formation'}  # plant: problem


def _registered() -> dict[str, str]:
    """Return where the problems are, ``module:Class`` by name, the package's own first."""
    registered = sorted(entry_points(group=GROUP), key=lambda item: item.module.startswith(_HERE))
    found = {item.name: item.value for item in registered}  # no other package replaces its own
    own = {name: found.pop(name) for name in SHORT_NAMES.values()}
    return own | dict(sorted(found.items()))


def problem_names() -> list[str]:
    """Names of all problems that can be loaded, the package's own first."""
    return list(_registered())


def load_problem(name: str) -> type[Problem]:
    """
    Import the class of the problem called `name`, or of ``module:Class``.

    Raise InvalidProblem if the name is unknown, or the class registered under it cannot be loaded.
    """
    if ':' in name:
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # as `python` itself has it, and console scripts do not
        return _load(name, name)
    known = _registered()
    if name not in known:
        hint = suggestion(name, [*known, *SHORT_NAMES])
        raise InvalidProblem(
            f"parameter 'problem' = '{name}' is not allowed: must be one of {', '.join(known)}, "
            f'or a stated problem such as my_module:MyProblem{hint and f" ({hint})"}'
        )
    return _load(name, known[name])


def check_file_is_for(
    problem: str, values: Mapping[str, Any], file: Path | str | None, reader: str = 'command'
) -> None:
    """Raise InvalidProblem if `values` of a file are for the other problem of the package."""
    named = values.get('problem', problem)
    if named != problem and {str(named), problem} <= {*SHORT_NAMES.values()}:
        raise InvalidProblem(
            f"the parameter file '{file}' is for problem = '{named}': this {reader} takes one for "
            f"'{problem}'"
        )


def _load(name: str, address: str) -> type[Problem]:
    module, _, attribute = address.partition(':')
    what = f"problem '{name}' cannot be loaded" + (f' from {address}' if address != name else '')
    try:
        found = getattr(import_module(module.strip()), attribute.strip())
    except (Exception, SystemExit) as error:  # noqa: B902
        # Whatever the registered package's import raises, as a script that ends by sys.exit.
        where, _ = place_of(error)
        if '/' in module or module.endswith('.py'):
            name = module.rsplit('/', 1)[-1].removesuffix('.py')
            raise InvalidProblem(
                f"{what}: give module:Class, a module's name, not a path, such as "
                f'{name}:{attribute} in the folder of {name}.py'
            ) from error
        if default := re.match(r"mutable default .*'(.+)'> for field (\w+) is", str(error)):
            kind, field = default.groups()
            advice = 'leave its annotation out, or make it a ClassVar, as it is no parameter'
            if kind in ('list', 'numpy.ndarray'):
                advice = f"write {field}: list[float] = parameter([...], 'what it is')"
            raise InvalidProblem(
                f"{what}: '{field}' has a {kind} as its default{where}: {advice}"
            ) from error
        absent = error.name if isinstance(error, ModuleNotFoundError) else None
        own = f'{module}.'.startswith(f'{absent}.')  # not one that it imports
        hint = ' (write module:Class, and run it in the folder of module.py)' if own else ''
        if isinstance(error, AttributeError) and error.obj is sys.modules.get(module.strip()):
            hint = f' ({suggestion(attribute, vars(error.obj)) or "it has no such class"})'
            place, here = getattr(error.obj, '__file__', 'Python itself'), Path(f'{module}.py')
            if here.is_file() and str(here.absolute()) != place:
                hint = f' (it is that of {place}: rename {here})'
        raise InvalidProblem(
            f'{what}: {type(error).__name__}: {one_line(error)}{hint}{where}'
        ) from error
    if not (isinstance(found, type) and issubclass(found, Problem)):
        raise InvalidProblem(f'{what}: {attribute} does not derive from DirectProblem or Problem')
    problem: type[Problem] = found
    problem.check_class()
    return problem
