# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What users, files and the network may hand over: valid in every corner, invalid in every way.

Everything is made of plain Python values (numbers, strings, lists, mappings), so that a case can
be kept in the corpus as JSON. `fuzz_messages` turns mappings into messages.
"""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st
from tdm_planner.parameters import ParameterSpec, Range

SPECIAL_NUMBERS = [
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e-30, -1e-30, 1e-9,
    1.0, -1.0, 3.0, math.pi, 1e3, 1e6, 1e12, 1.0000001e12, 1e18, -1e18, 1e150, 1e154, 1e300,
    1.7976931348623157e308, -1.7976931348623157e308,
]  # fmt: skip
SPECIAL_INTEGERS = [0, 1, -1, 2, 4, 7, 32, 33, 401, 1000, 2**31, 2**63 - 1, -(2**63), 2**64]
HUGE_INTEGERS = [10**309, -(10**309), 10**4000]
NAMES = ['robot1', 'robot2', 'robot3', 'a', 'b', 'arena', 'start', 'solver', '', ' ', '1st',
         '../x', 'a.b', 'a/b', 'é', 'x' * 300, '\x00', 'ros__parameters']  # fmt: skip

numbers = st.one_of(
    st.sampled_from(SPECIAL_NUMBERS), st.floats(), st.floats(-10, 10), st.floats(1e-6, 1e-2)
)
integers = st.one_of(
    st.sampled_from(SPECIAL_INTEGERS), st.integers(-10, 50), st.sampled_from(HUGE_INTEGERS)
)
scalars = st.one_of(numbers, integers, st.booleans(), st.none(), st.text(max_size=8))
anything = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)


def inside(allowed: Range) -> st.SearchStrategy[float]:
    """Numbers of an interval, its ends and its smallest and largest members above all."""
    lower = allowed.lower if math.isfinite(allowed.lower) else -1.7976931348623157e308
    upper = allowed.upper if math.isfinite(allowed.upper) else 1.7976931348623157e308
    ends = [x for x in (lower, upper, *SPECIAL_NUMBERS) if math.isfinite(x) and x in allowed]
    if allowed.lower_open:
        ends.append(math.nextafter(lower, math.inf))
    if allowed.upper_open:
        ends.append(math.nextafter(upper, -math.inf))
    whole = st.floats(lower, upper, exclude_min=allowed.lower_open, exclude_max=allowed.upper_open)
    return st.one_of(st.sampled_from(ends), whole)


def near(spec: ParameterSpec) -> st.SearchStrategy[Any]:
    """Values of a kind that people try: about the default."""
    factor = st.floats(0.3, 3.0)
    if spec.kind is float and spec.default:
        return factor.map(lambda f: f * spec.default).filter(lambda x: x in spec.range)
    return valid(spec)


def valid(spec: ParameterSpec) -> st.SearchStrategy[Any]:
    """Values that a declaration allows, its corners above all."""
    found: st.SearchStrategy[Any]
    if spec.choices:
        found = st.sampled_from(spec.choices)
    elif spec.kind is bool:
        found = st.booleans()
    elif spec.kind is str:
        found = st.text(max_size=12)
    elif spec.kind is int:
        lower = math.ceil(max(spec.range.lower, -(2.0**62)))
        upper = math.floor(min(spec.range.upper, 2.0**62))
        ends = [lower, upper, *(x for x in SPECIAL_INTEGERS if lower <= x <= upper)]
        found = st.one_of(st.sampled_from(ends), st.integers(lower, min(upper, lower + 50)))
    elif spec.kind is float:
        found = inside(spec.range)
    elif spec.length is not None:
        found = st.lists(inside(spec.range), min_size=spec.length, max_size=spec.length)
    elif spec.name == 'robots':
        found = robot_lists
    else:
        found = st.lists(inside(spec.range), max_size=6)
    return st.one_of(found, st.none()) if spec.optional else found


robot_lists = st.one_of(
    st.lists(st.sampled_from(['robot1', 'robot2', 'robot3']), min_size=1, max_size=3, unique=True),
    st.lists(st.sampled_from(NAMES), max_size=4),
    st.lists(st.text(max_size=4), max_size=3),
)


@st.composite
def parameter_sets(draw: Any, specifications: dict[str, ParameterSpec]) -> dict[str, Any]:
    """Parameters by dotted name: some near their defaults, some in corners, some of any kind."""
    names = sorted(specifications)
    kind = draw(st.sampled_from(['near', 'near', 'corner', 'corner', 'wild', 'mixed']))
    chosen = draw(st.lists(st.sampled_from(names), max_size=6, unique=True))
    values: dict[str, Any] = {}
    for name in chosen:
        spec = specifications[name]
        how = draw(st.sampled_from(['near', 'corner', 'wild'])) if kind == 'mixed' else kind
        values[name] = draw({'near': near, 'corner': valid}.get(how, lambda _: anything)(spec))
    if draw(st.integers(0, 19)) == 0:
        values[draw(st.text(max_size=10))] = draw(anything)
    return values


@st.composite
def forbidden_settings(draw: Any, specifications: dict[str, ParameterSpec]) -> tuple[str, Any]:
    """One parameter with a value that its declaration surely does not allow."""
    name = draw(st.sampled_from(sorted(specifications)))
    spec = specifications[name]
    wrong: list[Any] = [{'x': 1}, 'no such thing', '1.0x']
    if not spec.optional:
        wrong.append(None)
    if spec.kind is not bool:
        wrong.append(True)
    if spec.kind in (float, int):
        wrong += [math.nan, math.inf, -math.inf, *HUGE_INTEGERS[:2], [1.0], []]
        wrong += [x for x in (-1e-300, -1.0, 0.0, 2e12, 1e300) if x not in spec.range]
        if spec.kind is int:
            wrong += [1.5, 1e300, '1']
    elif spec.kind is str:
        wrong += [1.5, 7, ['a']]
        if not spec.choices:
            wrong = [value for value in wrong if not isinstance(value, str)]
    elif spec.kind == list[float]:
        wrong += [1.5, [math.nan] * 3, ['a', 'b', 'c'], [None, 0.0, 0.0], [math.inf, 0.0, 0.0]]
        if spec.length is not None:
            wrong += [[], [0.0] * (spec.length + 1), [0.0] * 2000]
    elif spec.kind == list[str]:
        wrong += [1.5, [1, 2], [None], ['a', 'a'], ['']]
    return name, draw(st.sampled_from(wrong))


# Messages, as mappings.

joint_names = st.one_of(
    st.permutations(['pendulum', 'disk']),
    st.permutations(['thruster', 'reaction_wheel']),
    st.lists(st.sampled_from(['pendulum', 'disk', 'thruster', 'reaction_wheel', '', 'é']),
             max_size=4),
)  # fmt: skip
calm = st.floats(-4, 4)
doubles = st.one_of(calm, calm, calm, numbers)
stamps = st.one_of(
    st.just({'sec': 0, 'nanosec': 0}),
    st.fixed_dictionaries(
        {'sec': st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), 1_700_000_000]),
         'nanosec': st.sampled_from([0, 1, 999_999_999, 2**32 - 1])}
    ),
)  # fmt: skip
frames = st.sampled_from(['', 'arena', 'world', 'map', '/arena', '../../etc', '<script>', 'é\n'])
headers = st.fixed_dictionaries({'stamp': stamps, 'frame_id': frames})


def rows(names: list[str]) -> st.SearchStrategy[list[float]]:
    """As many numbers as there are names, mostly."""
    right = st.lists(doubles, min_size=len(names), max_size=len(names))
    return st.one_of(right, right, right, st.lists(doubles, max_size=4))


@st.composite
def joint_states(draw: Any) -> dict[str, Any]:
    """sensor_msgs/JointState."""
    names = draw(joint_names)
    return {
        'header': draw(headers),
        'name': names,
        'position': draw(rows(names)),
        'velocity': draw(rows(names)),
        'effort': draw(rows(names)),
    }


@st.composite
def quaternions(draw: Any) -> dict[str, float]:
    """geometry_msgs/Quaternion: about the vertical, of another length, or of anything."""
    kind = draw(st.sampled_from(['yaw', 'yaw', 'yaw', 'scaled', 'any']))
    if kind == 'any':
        return {axis: draw(doubles) for axis in 'xyzw'}
    yaw = draw(st.floats(-10, 10))
    scale = 1.0 if kind == 'yaw' else draw(st.sampled_from([0.0, 0.9995, 1.01, 2.0, 1e200]))
    return {'x': 0.0, 'y': 0.0, 'z': scale * math.sin(yaw / 2), 'w': scale * math.cos(yaw / 2)}


vectors = st.fixed_dictionaries({'x': doubles, 'y': doubles, 'z': doubles})
twists = st.fixed_dictionaries({'linear': vectors, 'angular': vectors})
poses = st.fixed_dictionaries({'position': vectors, 'orientation': quaternions()})
odometries = st.fixed_dictionaries(
    {
        'header': headers,
        'child_frame_id': frames,
        'pose': st.fixed_dictionaries({'pose': poses}),
        'twist': st.fixed_dictionaries({'twist': twists}),
    }
)
goal_poses = st.fixed_dictionaries({'header': headers, 'pose': poses})


@st.composite
def instants(draw: Any, count: int) -> list[dict[str, int]]:
    """time_from_start of the points: increasing mostly, else anything."""
    if draw(st.integers(0, 4)) == 0:
        return [draw(stamps) for _ in range(count)]
    step = draw(st.sampled_from([1, 1_000_000, 50_000_000, 1_000_000_000, 10**12]))
    return [{'sec': k * step // 10**9, 'nanosec': k * step % 10**9} for k in range(count)]


counts = st.sampled_from([0, 1, 2, 3, 5, 20])


@st.composite
def joint_trajectories(draw: Any) -> dict[str, Any]:
    """trajectory_msgs/JointTrajectory."""
    names = draw(joint_names)
    count = draw(counts)
    times = draw(instants(count))
    same = draw(st.booleans())  # the same numbers in all points: a state that is held
    row = {key: draw(rows(names)) for key in ('positions', 'velocities', 'effort')}
    points = [
        {**(row if same else {key: draw(rows(names)) for key in row}),
         'accelerations': [], 'time_from_start': time}
        for time in times
    ]  # fmt: skip
    return {'header': draw(headers), 'joint_names': names, 'points': points}


@st.composite
def multi_dof_trajectories(draw: Any, robot: str = 'robot1') -> dict[str, Any]:
    """trajectory_msgs/MultiDOFJointTrajectory."""
    transforms = st.fixed_dictionaries({'translation': vectors, 'rotation': quaternions()})

    def few(part: Any) -> st.SearchStrategy[Any]:
        one = st.lists(part, min_size=1, max_size=1)
        return st.one_of(one, one, one, st.lists(part, max_size=2))

    points = [
        {'transforms': draw(few(transforms)), 'velocities': draw(few(twists)),
         'accelerations': [], 'time_from_start': time}
        for time in draw(instants(draw(counts)))
    ]  # fmt: skip
    names = draw(st.sampled_from([[robot], [robot], [robot], [], ['other'], [robot, robot]]))
    return {'header': draw(headers), 'joint_names': names, 'points': points}


@st.composite
def robot_plans(draw: Any, robot: str = 'robot1') -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the two halves of a robot's plan, which belong together more often than not."""
    motion = draw(multi_dof_trajectories(robot))
    if draw(st.integers(0, 3)) == 0:
        return motion, draw(joint_trajectories())
    names = ['thruster', 'reaction_wheel']
    controls = {
        'header': motion['header'],
        'joint_names': names,
        'points': [
            {'positions': draw(rows(names)), 'velocities': draw(rows(names)),
             'effort': draw(rows(names)), 'accelerations': [],
             'time_from_start': point['time_from_start']}
            for point in motion['points']
        ],
    }  # fmt: skip
    return motion, controls


@st.composite
def quiet_plans(draw: Any, plant: str) -> Any:
    """Return a plan that a tracker at rest takes: small numbers, alike at all points."""
    small = st.sampled_from([0.0, 0.0, 1e-3, -0.05, 5e-324])
    efforts = st.lists(st.one_of(small, doubles.filter(math.isfinite)), min_size=2, max_size=2)
    step, count = (
        draw(st.sampled_from([1, 10**6, 10**8, 10**10])),
        draw(st.sampled_from([2, 4, 20])),
    )
    times = [{'sec': k * step // 10**9, 'nanosec': k * step % 10**9} for k in range(count)]
    header = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': ''}
    rates = draw(st.lists(small, min_size=2, max_size=2))
    names = ['pendulum', 'disk'] if plant == 'pendulum' else ['thruster', 'reaction_wheel']
    joints = {
        'header': header,
        'joint_names': names,
        'points': [
            {'positions': [0.0, 0.0], 'velocities': rates, 'effort': draw(efforts),
             'accelerations': [], 'time_from_start': time}
            for time in times
        ],
    }  # fmt: skip
    if plant == 'pendulum':
        return joints
    still = dict.fromkeys('xyz', 0.0)
    point = {
        'transforms': [{'translation': still, 'rotation': {**still, 'w': 1.0}}],
        'velocities': [{'linear': {**still, 'x': rates[0]}, 'angular': still}],
        'accelerations': [],
    }
    points = [{**point, 'time_from_start': time} for time in times]
    return {'header': header, 'joint_names': ['robot1'], 'points': points}, joints


# Parameter files.

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


@st.composite
def yaml_texts(draw: Any) -> str:
    """YAML: well-formed parameter files, such with one odd piece, and noise."""
    import yaml

    kind = draw(st.sampled_from(['document', 'piece', 'noise']))
    if kind == 'noise':
        return draw(st.text(max_size=40))
    inner = draw(st.recursive(
        st.one_of(numbers, st.integers(-5, 5), st.text(max_size=5), st.none(), st.booleans()),
        lambda v: st.lists(v, max_size=3) | st.dictionaries(_keys, v, max_size=3),
        max_leaves=6,
    ))  # fmt: skip
    where = draw(st.sampled_from([None, '/**/planner', 'planner', '/**', '/ns', 'tracker']))
    document = inner if where is None else {where: {'ros__parameters': inner}}
    text: str = yaml.safe_dump(document)
    if kind == 'piece':
        piece = draw(_pieces)
        text = draw(st.sampled_from(
            [piece, f'a: {piece}\n', f'planner:\n  ros__parameters:\n    start: {piece}\n',
             f'{text}\n{piece}', f'- {piece}'])
        )  # fmt: skip
    return text
