# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What users, files and the network may hand over: strategies of Hypothesis.

Cases are plain values (numbers, strings, lists, mappings): one that escapes can be kept as JSON.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
import math
from typing import Any

from hypothesis import strategies as st
from tdm_planner.parameters import ParameterSpec, Range, specifications
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.tracking.pendulum_tracking import PendulumTrackerParameters
from tdm_planner.tracking.robot_tracking import RobotTrackerParameters
import yaml

BIGGEST = 1.7976931348623157e308
PROBLEMS = {kind.name: kind for kind in (PendulumSwingUp, RobotFormation)}
SPECIFICATIONS = {name: kind.parameter_specifications({}) for name, kind in PROBLEMS.items()}
TRACKERS = {'pendulum': PendulumTrackerParameters, 'robot': RobotTrackerParameters}

SPECIAL_NUMBERS = [
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e-30, -1e-30, 1e-9,
    1.0, -1.0, 3.0, math.pi, 1e3, 1e6, 1e12, 1.0000001e12, 1e18, -1e18, 1e150, 1e154, 1e300,
    BIGGEST, -BIGGEST,
]  # fmt: skip
SPECIAL_INTEGERS = [0, 1, -1, 2, 4, 7, 32, 33, 401, 1000, 2**31, 2**63 - 1, -(2**63), 2**64]
HUGE_INTEGERS = [10**309, -(10**309), 10**4000]
ROBOTS = ['robot1', 'robot2', 'robot3']
NAMES = [*ROBOTS, 'a', 'b', 'arena', 'start', 'solver', '', ' ', '1st',
         '../x', 'a.b', 'a/b', 'é', 'x' * 300, '\x00', 'ros__parameters']  # fmt: skip

numbers = (
    st.sampled_from(SPECIAL_NUMBERS) | st.floats() | st.floats(-10, 10) | st.floats(1e-6, 1e-2)
)
integers = st.sampled_from(SPECIAL_INTEGERS + HUGE_INTEGERS) | st.integers(-10, 50)
scalars = numbers | integers | st.booleans() | st.none() | st.text(max_size=8)


def nested(keys: st.SearchStrategy[str]) -> st.SearchStrategy[Any]:
    held = lambda v: st.lists(v, max_size=5) | st.dictionaries(keys, v, max_size=3)  # noqa: E731
    return st.recursive(scalars, held, max_leaves=8)


anything = nested(st.text(max_size=5))
robot_lists = st.one_of(
    st.lists(st.sampled_from(ROBOTS), min_size=1, max_size=3, unique=True),
    st.lists(st.sampled_from(NAMES), max_size=4),
    st.lists(st.text(max_size=4), max_size=3),
)


def inside(allowed: Range) -> st.SearchStrategy[float]:
    """Numbers of an interval, its ends and its smallest and largest members above all."""
    lower, upper = max(allowed.lower, -BIGGEST), min(allowed.upper, BIGGEST)
    ends = [lower, upper, math.nextafter(lower, upper), math.nextafter(upper, lower)]
    found = [x for x in (*ends, *SPECIAL_NUMBERS) if math.isfinite(x) and x in allowed]
    others = {'exclude_min': allowed.lower_open, 'exclude_max': allowed.upper_open}
    return st.sampled_from(found) | st.floats(lower, upper, **others)


def whole(allowed: Range) -> st.SearchStrategy[int]:
    lower = math.ceil(max(allowed.lower, -(2.0**62)))
    upper = math.floor(min(allowed.upper, 2.0**62))
    ends = [lower, upper, *(x for x in SPECIAL_INTEGERS if lower <= x <= upper)]
    found = st.sampled_from(ends) | st.integers(lower, min(upper, lower + 50))
    return found.filter(allowed.__contains__)


def few(item: st.SearchStrategy[Any], sizes: Sequence[int]) -> st.SearchStrategy[list[Any]]:
    return st.sampled_from(sizes).flatmap(lambda n: st.lists(item, min_size=n, max_size=n))


def valid(spec: ParameterSpec) -> st.SearchStrategy[Any]:
    """Values that a declaration allows, its corners above all."""
    kinds: dict[Any, Callable[[], st.SearchStrategy[Any]]] = {
        bool: st.booleans,
        str: lambda: st.text(max_size=12),
        int: lambda: whole(spec.range),
        float: lambda: inside(spec.range),
        list[str]: lambda: robot_lists,
        list[float]: lambda: few(inside(spec.range), [spec.length] if spec.length else range(7)),
    }
    found = st.sampled_from(spec.choices) if spec.choices else kinds[spec.value_type]()
    return found | st.none() if spec.optional else found


def near(spec: ParameterSpec) -> st.SearchStrategy[Any]:
    """Values that people try: about the default."""
    if spec.value_type is not float or not spec.default:
        return valid(spec)
    return st.floats(0.3, 3.0).map(lambda f: f * spec.default).filter(spec.range.__contains__)


@st.composite
def parameter_sets(draw: Any, specs: Mapping[str, ParameterSpec]) -> dict[str, Any]:
    """Parameters by dotted name: some near their defaults, some in corners, some of any kind."""
    ways: list[Callable[..., Any]] = [near, valid, lambda _: anything]
    one = draw(st.sampled_from([near, near, valid, valid, ways[2], None]))
    names = draw(st.lists(st.sampled_from(sorted(specs)), max_size=6, unique=True))
    values = {name: draw((one or draw(st.sampled_from(ways)))(specs[name])) for name in names}
    if draw(st.integers(0, 19)) == 0:
        values[draw(st.text(max_size=10))] = draw(anything)
    return values


@st.composite
def forbidden_settings(draw: Any) -> tuple[str, str, Any]:
    """Draw a problem, and one of its parameters with a value that is surely not allowed."""
    problem = draw(st.sampled_from(sorted(PROBLEMS)))
    name = draw(st.sampled_from(sorted(SPECIFICATIONS[problem])))
    spec = SPECIFICATIONS[problem][name]
    numbers = [math.nan, math.inf, -math.inf, *HUGE_INTEGERS[:2], [1.0], []]
    numbers += [x for x in (-1e-300, -1.0, 0.0, 2e12, 1e300) if x not in spec.range]
    lists = [1.5, [math.nan] * 3, ['a', 'b', 'c'], [None, 0.0, 0.0], [math.inf, 0.0, 0.0]]
    lists += [] if spec.length is None else [[], [0.0] * (spec.length + 1), [0.0] * 2000]
    kinds: dict[Any, list[Any]] = {
        float: numbers, int: [*numbers, 1.5, 1e300, '1'], str: [1.5, 7, ['a']],
        list[float]: lists, list[str]: [1.5, [1, 2], [None], ['a', 'a'], ['']],
    }  # fmt: skip
    wrong = [{'x': 1}, *kinds.get(spec.value_type, [])]
    wrong += [] if spec.optional else [None]
    wrong += [] if spec.value_type is bool else [True]
    wrong += [] if spec.value_type is str and not spec.choices else ['no such thing', '1.0x']
    return problem, name, draw(st.sampled_from(wrong))


_keys = st.one_of(
    st.sampled_from(['plant', 'limits', 'start', 'mass', 'torque', 'theta', 'x', 'robots', '/**',
                     '/**/planner', 'planner', 'ros__parameters', 'tracker', '*', '/a/b/planner']),
    st.text(max_size=6),
)  # fmt: skip
_pieces = st.sampled_from(
    ['!!python/object/apply:os.system [touch /tmp/owned]', '!!python/name:os.system',
     '!!binary x', '!!int ""', '!!int x', '!!float ""', '!!timestamp x', '!!bool x',
     '2001-99-99', '0x', '0b', '1_0', '190:20:30', '.inf', '.NaN', '-.inf', '1e400', '9' * 5000,
     '&a [*a]', '*nowhere', '&a {b: *a}', '!!set {a}', '!!omap [a: 1]', '!!pairs [a: 1]',
     '{? [1, 2] : 3}', '? {a: 1}\n: 2', '\t', '%YAML 1.3', '---\n---', '...', '<<: 1',
     '{<<: [1]}', '=', '!', '!!str', '!x y', '[' * 60, '{a: ' * 40, '\ufeff', '"\\ud800"', "'",
     '"', '|', '>', '@', '`', 'ros__parameters:', '- a', '0o17', '0777', '"\\x00"', '~', 'null',
     'yes', 'on', '1e5', '1.e+3', '08', '!!null x', '2020-01-01T25:00:00Z']
)  # fmt: skip
_documents = st.builds(
    lambda where, inner: yaml.safe_dump({where: {'ros__parameters': inner}} if where else inner),
    st.sampled_from([None, '/**/planner', 'planner', '/**', '/ns', 'tracker']),
    nested(_keys),
)
_places = ('{}', 'a: {}\n', 'planner:\n  ros__parameters:\n    start: {}\n', '- {}')
# Well-formed parameter files, odd pieces, also in or after such, and noise.
yaml_texts = st.one_of(
    _documents,
    st.builds('{}\n{}'.format, _documents, _pieces),
    st.builds(str.format, st.sampled_from(_places), _pieces),
    st.text(max_size=40),
)
FORGED = 'a\n[ERROR] [1.0] [forged]: as if the node had said it'
texts = st.one_of(
    st.sampled_from(['', 'arena', 'world', 'map', '/arena', '../../etc', '<script>', 'é\n', '%s%n',
                     '$(touch owned)', FORGED, FORGED * 500]),
    st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\x00'), max_size=8),
)  # fmt: skip
MEASURED = ['thruster', 'reaction_wheel']  # of a robot, beside its odometry
JOINTS = {'pendulum': ['pendulum', 'disk'], 'robot': ['x', 'y', 'yaw', *MEASURED]}
joint_names = st.one_of(
    *(st.permutations(names) for names in (*JOINTS.values(), MEASURED)),
    st.lists(st.sampled_from(['disk', *MEASURED, '', 'é', 'Disk', FORGED]), max_size=4),
)
doubles = st.one_of(*[st.floats(-4, 4)] * 3, numbers)
stamps = st.one_of(
    st.just({'sec': 0, 'nanosec': 0}),
    st.fixed_dictionaries(
        {'sec': st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), 1_700_000_000]),
         'nanosec': st.sampled_from([0, 1, 999_999_999, 2**32 - 1])}
    ),
)  # fmt: skip


@st.composite
def quaternions(draw: Any) -> dict[str, float]:
    """About the vertical, also of another length, or of anything."""
    if draw(st.integers(0, 4)) == 0:
        return {axis: draw(doubles) for axis in 'xyzw'}
    yaw = draw(st.floats(-10, 10))
    scale = draw(st.sampled_from([1.0] * 12 + [0.0, 0.999, 2.0, 1e200]))
    return {'x': 0.0, 'y': 0.0, 'z': scale * math.sin(yaw / 2), 'w': scale * math.cos(yaw / 2)}


# By type or by name of a field; `messages` makes all others of what their types allow.
HINTS: dict[str, Any] = {
    'double': doubles, 'boolean': st.booleans(), 'octet': st.binary(min_size=1, max_size=1),
    'string': texts, 'name': joint_names, 'joint_names': joint_names,
    'builtin_interfaces/Time': stamps, 'builtin_interfaces/Duration': stamps,
    'geometry_msgs/Quaternion': quaternions(),
    'accelerations': st.just([]), 'covariance': st.just([0.0] * 36),
}  # fmt: skip
_SIZES = {'double': [2] * 40 + [0, 1, 3, 4]}  # two joints, one body: more often than not
_OTHER_SIZES = [1] * 20 + [0, 2]


def messages(kind: Any, **hints: Any) -> st.SearchStrategy[dict[str, Any]]:
    """Any message of a ROS type as a mapping; `hints` go before `HINTS`."""
    every = {**HINTS, **hints}

    def of(name: str, text: str) -> st.SearchStrategy[Any]:
        known: st.SearchStrategy[Any] | None = every.get(name, every.get(text))
        if known is not None:
            return known
        if text.startswith('sequence<'):
            inner = text.removeprefix('sequence<').removesuffix('>')
            return few(of('', inner), _SIZES.get(inner, _OTHER_SIZES))
        if text.endswith(']'):
            inner, _, count = text.removesuffix(']').rpartition('[')
            return few(of('', inner), [int(count)])
        if '/' in text:
            return messages(message_type(text), **hints)
        bits, unsigned = int(text.lstrip('uint')), text[0] == 'u'
        ends = [0, 2**bits - 1] if unsigned else [-(2 ** (bits - 1)), 2 ** (bits - 1) - 1]
        return st.one_of(st.sampled_from(ends), st.integers(0, 10))

    fields = kind.get_fields_and_field_types().items()
    return st.fixed_dictionaries({name: of(name, text) for name, text in fields})


def message_type(text: str) -> Any:
    package, name = text.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def message(text: str, value: Any) -> Any:
    """Make of a mapping a message of the type `package/Name`; of a list several."""
    if isinstance(value, list):
        return [message(text, part) for part in value]
    made = message_type(text)()
    kinds = made.get_fields_and_field_types()
    for name, item in value.items():
        kind = kinds[name].removeprefix('sequence<').removesuffix('>')
        setattr(made, name, message(kind, item) if '/' in kind else item)
    return made


@st.composite
def plans(draw: Any, kind: str, names: Any = joint_names) -> dict[str, Any]:
    """Draw a trajectory: its instants increase mostly, some hold one state."""
    empty = {'joint_names': names, 'points': st.just([])}
    plan = draw(messages(message_type(f'trajectory_msgs/{kind}'), **empty))
    point = messages(message_type(f'trajectory_msgs/{kind}Point'))
    count = draw(st.sampled_from([0, 1, 2, 3, 5]))
    same = draw(point) if draw(st.booleans()) else None
    plan['points'] = [dict(same) if same else draw(point) for _ in range(count)]
    if draw(st.integers(0, 4)):
        step = draw(st.sampled_from([1, 1_000_000, 50_000_000, 1_000_000_000, 10**12]))
        for k, drawn in enumerate(plan['points']):
            drawn['time_from_start'] = _instant(k * step)
    return plan


def _instant(nanoseconds: int) -> dict[str, int]:
    return {'sec': min(nanoseconds // 10**9, 2**31 - 1), 'nanosec': nanoseconds % 10**9}


@st.composite
def quiet_plans(draw: Any, plant: str) -> Any:
    """Return a plan that a tracker at rest takes: small numbers, alike at all points."""
    size = len(JOINTS[plant])
    small = st.sampled_from([0.0, 0.0, 1e-3, -0.05, 5e-324])
    efforts = few(small | doubles.filter(math.isfinite), [size])
    step, count = draw(st.tuples(*map(st.sampled_from, ([1, 10**6, 10**8, 10**10], [2, 4, 20]))))
    rest = {'positions': [0.0] * size, 'velocities': draw(few(small, [size]))}
    points = [{**rest, 'effort': draw(efforts), 'time_from_start': _instant(k * step)}
              for k in range(count)]  # fmt: skip
    return {'joint_names': JOINTS[plant], 'points': points}


def states(plant: str) -> st.SearchStrategy[Any]:
    joints, odometry = map(message_type, ('sensor_msgs/JointState', 'nav_msgs/Odometry'))
    moved = messages(odometry) | messages(odometry, double=st.floats(-4, 4))
    return messages(joints) if plant == 'pendulum' else st.tuples(moved, messages(joints))


@st.composite
def histories(draw: Any, plant: str) -> dict[str, Any]:
    """Draw parameters of a tracker and events of its life in any order, each with an instant."""
    any_plans = plans('JointTrajectory', st.just(JOINTS[plant]) | joint_names)
    kinds: list[tuple[str, list[Any]]] = [
        ('tick', []),
        ('state', [states(plant)]),
        ('plan', [any_plans, st.sampled_from([0.0, 0.01, 1.0, -1.0, 1e9])]),
        *[('good state', [])] * 3,
        *[('plan', [quiet_plans(plant), st.sampled_from([0.0, 0.005, 0.05])])] * 2,
    ]
    events, now = list[Any](), 100.0
    for _ in range(draw(st.integers(1, 12))):
        now += draw(st.sampled_from([0.0, 0.005, 0.005, 0.05, 1.0, -5.0, 5.0]))
        kind, made = draw(st.sampled_from(kinds))
        event = [kind, now, *map(draw, made)]
        if kind == 'plan':
            event[-1] += now
        events.append(event)
    chosen = draw(st.just({}) | parameter_sets(specifications(TRACKERS[plant])))
    return {'plant': plant, 'parameters': chosen, 'events': events}
