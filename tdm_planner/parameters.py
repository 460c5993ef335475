# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Parameters declared once: type, default, unit, range and description stand with the field.

From these declarations come the validation of Python arguments and YAML files, the descriptors of
the ROS parameters, the default YAML files and the tables of the documentation.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping
import dataclasses
from dataclasses import dataclass, field, replace
import difflib
from functools import cache
import math
import operator
from typing import Any, get_args, get_type_hints, TypeVar

from tdm_planner.exceptions import InvalidProblem

T = TypeVar('T')

_METADATA_KEY = 'tdm_parameter'
_LONGEST_INTEGER = 10**60
_LONGEST_NAME = 200
_LONGEST_VALUE = 80
MISSPELLED = 0.9  # likeness of names, of which one is a slip
_MOST_PARAMETERS = 20_000
_TYPE_NAMES = {
    float: 'a number',
    int: 'an integer',
    bool: 'true or false',
    str: 'a string',
    list[float]: 'a list of numbers',
    list[str]: 'a list of strings',
}
# Type of a field's values, and whether it may be unset, by the field's annotation.
_DECLARED: dict[Any, tuple[Any, bool]] = {
    **{kind: (kind, False) for kind in _TYPE_NAMES},
    **{kind | None: (kind, True) for kind in _TYPE_NAMES},
}


@dataclass(frozen=True)
class Range:
    """An interval of allowed values, closed unless said otherwise; in steps from `lower` on."""

    lower: float = -math.inf
    upper: float = math.inf
    lower_open: bool = False
    upper_open: bool = False
    step: int = 0

    def __contains__(self, value: float) -> bool:
        """Whether `value` lies in the interval; never true for NaN."""
        above = value > self.lower if self.lower_open else value >= self.lower
        below = value < self.upper if self.upper_open else value <= self.upper
        return above and below and not (self.step and (value - self.lower) % self.step)

    @property
    def bounded(self) -> bool:
        """Whether at least one end is finite."""
        return math.isfinite(self.lower) or math.isfinite(self.upper)

    def __str__(self) -> str:
        """Interval notation, e.g. ``(0, inf)``."""
        steps = f' in steps of {self.step}' if self.step else ''
        left = '(' if self.lower_open or math.isinf(self.lower) else '['
        right = ')' if self.upper_open or math.isinf(self.upper) else ']'
        return f'{left}{self.lower:g}, {self.upper:g}{right}{steps}'


# Of numbers in SI units that make sense: products and ratios of a few stay finite, and not zero.
LARGEST = 1e12
POSITIVE = Range(1.0 / LARGEST, LARGEST)
NON_NEGATIVE = Range(0.0, LARGEST)
SIGNED = Range(-LARGEST, LARGEST)
SEED = Range(0.0, 2.0**63, upper_open=True)
ANY = Range()


@dataclass(frozen=True)
class ParameterSpec:
    """
    One parameter as users see it.

    `value_type` is one of float, int, bool, str, list[float], list[str]; `optional` parameters may
    be unset (None). `length` fixes the number of elements of a list, which is else a multiple of
    `multiple`.
    """

    name: str
    value_type: Any
    default: Any
    description: str
    unit: str = ''
    range: Range = ANY  # noqa: A003
    choices: tuple[str, ...] = ()
    optional: bool = False
    read_only: bool = False
    length: int | None = None
    multiple: int = 1

    @property
    def allowed(self) -> str:
        """Return what is allowed, in words that fit an error message."""
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        kind: str = _TYPE_NAMES[self.value_type]
        if self.length is not None:
            kind = kind.replace('a list of', f'a list of {self.length}')
        elif self.multiple > 1:
            counts = f'0, {self.multiple}, {2 * self.multiple}, ...'
            kind = kind.replace('a list of', f'a list of {counts}')
        unit = f' {self.unit}' if self.unit else ''
        if self.value_type in (float, int, list[float]):
            return f'{kind} in {self.range}{unit}'
        return kind

    def check(self, value: Any) -> Any:
        """Return `value` in the declared type; raises InvalidProblem if it is not allowed."""
        if value is None and self.optional:
            return None
        checked = self._coerce(value)
        numbers = checked if isinstance(checked, list) else [checked]
        numeric = self.value_type in (float, int, list[float])
        if (
            (self.choices and checked not in self.choices)
            or (numeric and not all(n in self.range and abs(n) < math.inf for n in numbers))
            or (self.length is not None and len(checked) != self.length)
            or (self.multiple > 1 and len(checked) % self.multiple)
        ):
            raise self._error(value)
        return checked

    def _coerce(self, value: Any) -> Any:
        if self.value_type in (bool, str):
            if isinstance(value, self.value_type):
                return value
        elif self.value_type in (float, int):
            return self._number(value, self.value_type)
        elif not isinstance(value, str | bytes | Mapping) and hasattr(value, '__iter__'):
            (element,) = get_args(self.value_type)
            try:
                items = list(value)
            except TypeError:  # a numpy array without dimensions
                raise self._error(value) from None
            if element is float:
                return [self._number(item, float) for item in items]
            if all(isinstance(item, str) for item in items):
                return items
        raise self._error(value)

    def _number(self, value: Any, kind: type) -> Any:
        if isinstance(value, bool) or not hasattr(value, '__float__'):
            raise self._error(value)
        try:
            return operator.index(value) if kind is int else float(value)
        except (OverflowError, ValueError, TypeError):
            raise self._error(value) from None

    def _error(self, value: Any) -> InvalidProblem:
        return InvalidProblem(
            f"parameter '{self.name}' = {short(value)} is not allowed: must be {self.allowed}"
        )


def short(value: Any) -> str:
    """Return a value as an error message shows it: on one line, not too long."""
    if isinstance(value, int) and abs(value) > _LONGEST_INTEGER:
        return f'an integer of {value.bit_length()} bits'  # too long to be written out
    if isinstance(value, str):
        value = repr(value[:_LONGEST_VALUE])
    if isinstance(value, array):  # as services hand lists over
        value = value.tolist()
    try:
        text = ' '.join(str(value).split())
    except (ValueError, RecursionError):
        text = f'a {type(value).__name__}'
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + '...'


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = '',
    allowed: Range | tuple[float, float] = ANY,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    length: int | None = None,
    multiple: int = 1,
) -> Any:
    """Declare a dataclass field as a parameter; the arguments are those of `ParameterSpec`."""
    interval = Range(*allowed) if isinstance(allowed, tuple) else allowed
    given = '', None, default, description, unit, interval, choices
    spec = ParameterSpec(*given, read_only=read_only, length=length, multiple=multiple)
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata={_METADATA_KEY: spec})
    return field(default=default, metadata={_METADATA_KEY: spec})


def positive(default: float, description: str, unit: str = '') -> Any:
    """Declare a dataclass field as a parameter that is a positive number of this unit."""
    return parameter(default, description, unit=unit, allowed=POSITIVE)


def group(cls: type[T]) -> T:
    """Declare a dataclass field as a group of parameters; its name is their prefix."""
    made: T = field(default_factory=cls)
    return made


_hints: Callable[..., dict[str, Any]] = cache(get_type_hints)  # it takes a millisecond


@cache
def _declared(cls: type, prefix: str = '') -> list[tuple[str, ParameterSpec | type]]:
    """
    Return the fields that are parameters, with specification, or groups, with class, by name.

    The specifications' own names begin with `prefix`.

    Raise InvalidProblem for the first field that is of no type a parameter can have.
    """
    try:
        hints = _hints(cls)
    except Exception as error:  # noqa: B902 - of what stands there
        raise InvalidProblem(f'an annotation of {cls.__name__} is no type: {error}') from error
    found: list[tuple[str, ParameterSpec | type]] = []
    for item in dataclasses.fields(cls):
        hint = hints[item.name]
        if not item.init:  # it follows from others
            continue
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            found.append((item.name, hint))
        elif _METADATA_KEY in item.metadata:
            if hint not in _DECLARED:
                raise InvalidProblem(
                    f"parameter '{item.name}' is declared as {shown(hint)}: must be float, int, "
                    'bool, str, list[float] or list[str]'
                )
            kind, optional = _DECLARED[hint]
            spec = item.metadata[_METADATA_KEY]
            name = prefix + item.name
            made = replace(spec, name=name, value_type=kind, optional=optional)
            found.append((item.name, made))
    return found


def specifications(cls: type, prefix: str = '') -> dict[str, ParameterSpec]:
    """
    Every parameter of a dataclass, by dotted name, groups expanded, in order of declaration.

    Raise InvalidProblem for the first field that is of no type a parameter can have.
    """
    found: dict[str, ParameterSpec] = {}
    for item, declared in _declared(cls, prefix):
        if isinstance(declared, ParameterSpec):
            found[declared.name] = declared
        else:
            found.update(specifications(declared, f'{prefix}{item}.'))
    return found


def build(cls: type[T], values: Mapping[str, Any], prefix: str = '') -> T:
    """
    Make a dataclass of parameters from dotted names; names that are absent keep the default.

    Raise InvalidProblem for the first value that is not allowed.
    """
    kind: Any = cls
    arguments: dict[str, Any] = {}
    for item, declared in _declared(kind, prefix):
        if not isinstance(declared, ParameterSpec):
            arguments[item] = build(declared, values, f'{prefix}{item}.')
        elif declared.name in values:
            arguments[item] = declared.check(values[declared.name])
    return cls(**arguments)


def check_fields(instance: Any, prefix: str = '') -> None:
    """
    Check every parameter of a dataclass and of its groups, and give it its declared type.

    Raise InvalidProblem for the first wrong value; `prefix` begins the parameters' names.
    """
    kind: Any = type(instance)
    for item, declared in _declared(kind, prefix):
        value = getattr(instance, item)
        if isinstance(declared, ParameterSpec):
            object.__setattr__(instance, item, declared.check(value))
        elif dataclasses.is_dataclass(type(value)):
            check_fields(value, f'{prefix}{item}.')
        else:
            raise InvalidProblem(
                f"parameter '{prefix}{item}' = {short(value)} is not allowed: must be an instance "
                'of its class; from_parameters takes mappings'
            )


class Validated:
    """Mixin for a frozen dataclass of parameters: its fields are checked when it is made."""

    def __post_init__(self) -> None:
        """Check every declared field; raises InvalidProblem for the first wrong value."""
        check_fields(self)


def flatten(mapping: Mapping[str, Any]) -> dict[str, Any]:
    """
    Nested mappings as dotted names: ``{"plant": {"mass": 1}}`` to ``{"plant.mass": 1}``.

    Raise InvalidProblem if it is not a mapping, or one nested without end.
    """
    if not isinstance(mapping, Mapping):
        raise InvalidProblem(
            f'parameters must be a mapping of names to values, not {short(mapping)}'
        )
    flat: dict[str, Any] = {}
    _flatten(mapping, '', flat)
    return flat


def _flatten(mapping: Mapping[str, Any], prefix: str, flat: dict[str, Any]) -> None:
    for key, value in mapping.items():
        name = f'{prefix}{short(key) if isinstance(key, int) else key}'
        if len(name) > _LONGEST_NAME or len(flat) > _MOST_PARAMETERS:
            raise InvalidProblem(
                f"parameter '{shown(name)}' is one of too many, or its name is too long: at most "
                f'{_MOST_PARAMETERS} parameters, whose names have at most {_LONGEST_NAME} letters'
            )
        if isinstance(value, Mapping):
            _flatten(value, name + '.', flat)
        elif name in flat:
            raise InvalidProblem(f"parameter '{shown(name)}' is given twice, once nested")
        else:
            flat[name] = value


def shown(name: object) -> str:
    """Return a name as it can stand in a sentence: short, on one line, without control codes."""
    text = short(name)
    return text[1:-1] if isinstance(name, str) else text


def suggestion(name: str, known: Iterable[str], likeness: float = 0.6) -> str:
    """Return a question that names those known that are most like `name`; '' if none are."""
    similar = difflib.get_close_matches(name, known, 3, likeness)
    return f'did you mean {" or ".join(similar)}?' if similar else ''


def to_mapping(instance: Any, prefix: str = '') -> dict[str, Any]:
    """Return the values of a dataclass of parameters by dotted name (the inverse of `build`)."""
    names = specifications(type(instance))
    return {prefix + name: operator.attrgetter(name)(instance) for name in names}
