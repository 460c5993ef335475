# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 parameter files and settings ``name=value``, read without ROS; the package's files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
import re
import sys
from typing import Any

from tdm_planner.exceptions import InvalidProblem, one_line
from tdm_planner.parameters import flatten, MISSPELLED, shown
from tdm_planner.starting import ament_prefixes, PACKAGE
import yaml

_LONGEST = 300  # letters of an error


def config_file(name: str) -> Path:
    """
    Path of a file in the folder `config`, e.g. ``pendulum.yaml``.

    That folder is the first of: a sourced ROS 2 workspace's (colcon), the Python environment's
    (pip), the source tree's (an editable installation, or none).
    """
    shares = [prefix / 'share' / PACKAGE for prefix in ament_prefixes(PACKAGE)]
    shares += [Path(sys.prefix, 'share', PACKAGE), Path(__file__).resolve().parents[1]]
    folders = [share / 'config' for share in shares]
    return next(filter(Path.is_dir, folders), folders[-1]) / name


class _Loader(yaml.SafeLoader):
    """
    YAML as ROS 2 reads it, without objects of Python.

    ``1e-4`` is a number (PyYAML alone takes it for a string). Aliases are rejected, as in ROS 2:
    a few of them make a document without end. So are keys given twice, of which PyYAML drops one.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem='aliases are not supported', problem_mark=mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set[str]()
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        for key in (key for key, _ in pairs if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                line = key.start_mark.line + 1
                raise yaml.YAMLError(f"'{shown(key.value)}' is given twice, again in line {line}")
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)


def parse_yaml(text: str) -> Any:
    """Parse one YAML document; raises yaml.YAMLError."""
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a SafeLoader
    except (ValueError, LookupError, AttributeError, TypeError, ArithmeticError) as error:
        # What PyYAML's constructors raise for values that are not what their tag says.
        raise yaml.YAMLError(f'a value is not what it seems to be: {error}') from None
    except RecursionError:
        raise yaml.YAMLError('it is nested too deeply') from None


def read_document(path: Path) -> Any:
    """Return the content of a parameter file; raises InvalidProblem where it cannot be read."""
    try:
        return parse_yaml(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise InvalidProblem(f"the file '{path}' cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise InvalidProblem(
            f"the file '{path}' is not YAML: {one_line(error)[:_LONGEST]}"
        ) from None


def read_parameters(
    path: Path | None,
    settings: Sequence[str] = (),
    node: str = 'planner',
    namespace: str | None = None,
    *,
    required: bool = True,
) -> dict[str, Any]:
    """
    Return a node's flat parameters from a parameter file and ``name=value`` settings.

    `node`, `namespace` and `required` are those of `ros_parameters`.

    Raise InvalidProblem if the file cannot be read or a setting is not of that form.
    """
    values: dict[str, Any] = {}
    if path is not None:
        values.update(ros_parameters(read_document(path), node, namespace, required=required))
    for setting in settings:
        name, equals, text = setting.partition('=')
        if not (name and equals):
            raise InvalidProblem(f"the setting '{shown(setting)}' must have the form name=value")
        try:
            values[name] = parse_yaml(text)
        except yaml.YAMLError as error:
            raise InvalidProblem(
                f"the setting '{shown(setting)}' has no value: {one_line(error)[:_LONGEST]}"
            ) from None
    return values


def ros_parameters(
    document: Any, node: str = 'planner', namespace: str | None = None, *, required: bool = True
) -> dict[str, Any]:
    """
    Return the flat parameters of `node` in a ROS 2 parameter file's document.

    Accepts ``{node: {ros__parameters: {...}}}``, with ``/**`` and any namespace before the node's
    name, as well as a plain mapping of parameters. With a `namespace` only those sections count
    that a node of that name and namespace takes; of several that do, the later one wins.

    Raise InvalidProblem if the document is not a mapping, a section has no ``ros__parameters`` or
    a name that is a misspelt `node`, or, where one is `required`, there are only those of others.
    """
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise InvalidProblem(
            f'a parameter file must hold a mapping, not {type(document).__name__}'
        )
    sections = list(_sections(document))
    for key, value in document.items():
        named = isinstance(value, Mapping) and 'ros__parameters' not in value
        if named and value and str(key).startswith('/') and not any(_sections({key: value})):
            raise InvalidProblem(
                f"section '{shown(key)}' of the parameter file has no 'ros__parameters' below it"
            )
    if not sections:
        return flatten({str(key): value for key, value in document.items()})
    full_name = node
    if namespace is not None:
        full_name = '/'.join(['', *filter(None, namespace.split('/')), node])
    found: dict[str, Any] = {}
    others: list[str] = []
    for name, values in sections:
        if _is_for(name, full_name):
            found.update(flatten(values))
        else:
            others.append(name)
    nodes = {name.rpartition('/')[2]: name for name, _ in sections}
    slips = get_close_matches(node, filter(str.isalpha, nodes), 1, MISSPELLED)
    if slips and node not in nodes:
        raise InvalidProblem(
            f"section '{nodes[slips[0]]}' of the parameter file is for no node of ours: did you "
            f'mean {node}?'
        )
    if required and not found and others:
        raise InvalidProblem(
            f"the parameter file has no section for node '{full_name}', only for "
            f'{", ".join(others)}'
        )
    return found


def _sections(
    document: Mapping[Any, Any], path: str = ''
) -> Iterator[tuple[str, Mapping[Any, Any]]]:
    for key, value in document.items():
        if key == 'ros__parameters' and path and not isinstance(value, Mapping):
            raise InvalidProblem(
                f"'ros__parameters' of section '{shown(path)}' of the parameter file must be a "
                f'mapping of parameters, not {shown(value)}'
            )
        if isinstance(value, Mapping):
            if key == 'ros__parameters' and path:
                yield path, value
            else:
                yield from _sections(value, f'{path}/{str(key).strip("/")}')


def _is_for(section: str, node: str) -> bool:
    """Whether a section is for a node, by the rules of rcl where its name is fully qualified."""
    tokens = section.split('/')[1:]
    if not node.startswith('/'):
        return tokens[-1] in (node, '**', '*')
    wildcards = {'**': r'(/\w+)*', '*': r'/\w+'}
    pattern = ''.join(wildcards.get(token, '/' + re.escape(token)) for token in tokens)
    return re.fullmatch(pattern, node) is not None
