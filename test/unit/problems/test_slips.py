# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Slips in the class of a problem, and starts and ends that contradict it: one sentence each."""

from dataclasses import dataclass, field, replace
import re
import sys

import numpy as np
import pytest
from stated import Car, Cart, changed, Driven, refused, Start
from tdm_planner.exceptions import VerificationFailed
from tdm_planner.parameters import group, parameter, POSITIVE, Validated
from tdm_planner.problem_check import check_problem
from tdm_planner.problems import DirectProblem, SolverParameters
from tdm_planner.problems.registry import load_problem


@dataclass(frozen=True)
class Place:  # not Validated
    x: float = parameter(1.0, 'place', unit='m', allowed=POSITIVE)


@dataclass(frozen=True)
class Plain(DirectProblem):
    """Neither Validated: the ranges of a problem's parameters are checked all the same."""

    control_names, control_units = ('u',), ('N',)
    state_names, state_units = ('x',), ('m',)
    mass: float = parameter(20.0, 'mass', unit='kg', allowed=POSITIVE)
    goal: list[float] = parameter([1.0], 'goal', unit='m', length=1)
    start: Place = group(Place)
    outputs = duration = invert = derivative = Car.final_cost


@dataclass(frozen=True)
class Heavy(Plain):
    """What follows from a parameter."""

    def __post_init__(self):
        object.__setattr__(self, 'weight', 9.81 * self.mass)


@pytest.mark.parametrize('kind', [Plain, Heavy])
@pytest.mark.parametrize(
    ('given', 'told'),
    [
        ({'mass': -1.0}, "parameter 'mass' = -1.0 is not allowed: must be a number in [1e-12"),
        ({'mass': None}, "parameter 'mass' = None is not allowed"),
        ({'goal': [1.0, 2.0]}, "parameter 'goal' = [1.0, 2.0] is not allowed"),
        ({'start': Place(x=-1.0)}, "parameter 'start.x' = -1.0 is not allowed"),
        ({'start': Place}, "parameter 'start' = "),
    ],
)
def test_ranges_of_a_problem_are_checked_whatever_it_derives_from(kind, given, told):
    assert refused(lambda: kind(**given)).startswith(told)
    made = kind(mass=3, start=Place(x=2))
    assert [type(value) for value in (made.mass, made.start.x)] == [float, float]
    assert getattr(made, 'weight', 29.43) == pytest.approx(29.43)


ASKED = check_problem, lambda made: [refused(made.solve)]


@pytest.mark.parametrize('reasons_of', ASKED)
@pytest.mark.parametrize(
    ('given', 'begins', 'told'),
    [
        ({'vx': 1.0}, {'vx': 0.0}, 'start.vx = 1, but every motion begins with vx = 0: outputs()'),
        ({'way': 50.0}, {'way': 0.0}, 'start.way = 50, but every motion begins with way = 0: '),
        ({'x': -1.0}, {'x': 1e-2 - 1.0}, 'begins with x = -0.99: '),
        ({'yaw': 7.0}, {'yaw': 7.0 - 4.0 * np.pi}, 'yaw = -5.566371, by whole turns: '),
        ({'vx': 7.0}, {'vx': 7.0 - 4.0 * np.pi}, 'vx = -5.566371: '),
    ],
)
def test_a_motion_begins_where_the_group_start_says(reasons_of, given, begins, told):
    start = replace(Start(), **given)
    made = changed(Driven, begin=lambda s: replace(s.start, **begins))(start=start)
    assert [told in reason for reason in reasons_of(made)] == [True]


def test_a_start_may_be_rounded_free_or_of_other_names():
    rounded = changed(Driven, begin=lambda s: replace(s.start, x=-2.0 + 1e-4, yaw=1e-16))
    free = changed(Driven, begin=lambda s: replace(s.start, x=None))
    other = replace(Start(), x=-3.0, load=1.0)
    for made in (rounded(), free(start=other), Driven(start=other), Cart(start=3.0)):
        assert check_problem(made) == []


def margin(self, t, x, u):
    return {'wall': x[0] + 9.0}


@pytest.mark.parametrize('use', [lambda c: c(), lambda c: c.from_parameters({})])
@pytest.mark.parametrize(
    ('name', 'meant'),
    [
        ('margin', 'margins'),
        ('control_limit', 'control_limits'),
        ('end_condition', 'end_conditions'),
        ('finalcost', 'final_cost'),
        ('reserves', 'reserve'),
    ],
)
def test_a_method_that_is_misspelt_is_refused(name, meant, use):
    made = changed(Driven, **{name: margin})
    assert refused(lambda: use(made)) == f'Changed.{name} is never used: did you mean {meant}?'


def test_methods_for_others_are_no_misspelt_ones():
    """Whatever a script calls: what is less alike, or stands beside what it is like."""
    names = 'margins_of', 'start_state', 'terminal_cost', 'initial_guess', 'control_at', 'weights'
    made = changed(Driven, **dict.fromkeys(names, margin), margins=margin, margin=margin)
    assert made().solve(deadline=1.0).verification.ok


def test_a_function_that_keeps_values_of_earlier_calls_is_refused():
    """With symbols it gave what numpy had left there, an array over nodes."""

    def told(rate):
        kept = []

        def derivative(self, x, u):
            kept.append(u[0])
            return x[1], rate(x, u, kept), u[1], x[1]

        made = changed(Driven, derivative=derivative)
        return [refused(made().solve) for _ in range(2)]

    alone = 'it must depend on its arguments at the same node alone'
    message, _ = told(lambda x, u, kept: kept[0] - 0.1 * x[1])
    given = 'derivative of Changed gives 10 values when it is traced, but 4 with numpy: '
    assert message == given + alone
    message, again = told(lambda x, u, kept: u[0] - 0.1 * kept[-min(2, len(kept))])
    assert message == 'derivative of Changed keeps values of other calls: ' + alone
    assert again.startswith("what derivative returns: 'vx' = ")
    assert again.endswith('which is not a real number')


def test_what_a_post_init_raises_keeps_its_words():
    def differ(self):
        if self.limit and self.drag:
            raise ValueError('drag and limit must differ')

    words = 'drag and limit must differ'
    assert refused(dataclass(frozen=True)(changed(Car, __post_init__=differ))).endswith(words)


class OwnInit(Plain):
    """Not every parameter can be given."""

    def __init__(self, mass=20.0):
        self.mass = mass


class Assigns(Plain):
    """As in a class that is not frozen."""

    def __post_init__(self):
        self.weight = 9.81 * self.mass


class Fails(Plain):
    """A misspelt parameter."""

    def __post_init__(self):
        return self.masses


@pytest.mark.parametrize(
    ('kind', 'told'),
    [
        (OwnInit, 'OwnInit has an __init__ of its own: leave it out, @dataclass writes one; what'),
        (
            Assigns,
            '__post_init__ of Assigns raises FrozenInstanceError in line # of test_slips.py, '
            '`self.weight = 9.81 * self.mass`: a problem is frozen: state what follows from its '
            'parameters as a property',
        ),
        (
            Fails,
            "of test_slips.py, `return self.masses`: Fails has no 'masses': did you",
        ),
    ],
)
def test_a_problem_is_made_by_its_dataclass(kind, told):
    made = dataclass(frozen=True)(kind)
    for use in (made, lambda: made.from_parameters({})):
        assert told in re.sub(r'line \d+', 'line #', refused(use))


LIST = "write goal: list[float] = parameter([...], 'what it is')"


@pytest.mark.parametrize(
    ('field', 'told'),
    [
        (
            'goal: list[float] = [1.0]',
            "'goal' has a list as its default in line 9 of slip.py, #: " + LIST,
        ),
        ("goal: list[float] = parameter(np.zeros(2), 'goal')", LIST),
        (
            "reserve: dict = {'rock': 0.1}",
            "'reserve' has a dict as its default in line 9 of slip.py, #: leave its anno",
        ),
    ],
)
def test_a_default_that_can_be_changed_is_named_with_a_way_out(field, told, tmp_path, monkeypatch):
    (tmp_path / 'slip.py').write_text(
        'from dataclasses import dataclass\nimport numpy as np\n\n'
        'from tdm_planner.parameters import parameter\n'
        'from tdm_planner.problems import DirectProblem\n\n\n'
        f'# As a student may write it.\n@dataclass\nclass Slip(DirectProblem):\n    {field}\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'slip', raising=False)
    message = refused(lambda: load_problem('slip:Slip')).replace('`@dataclass`', '#')
    assert told in message
    assert 'default_factory' not in message


@pytest.mark.parametrize('name', ['./crossing.py:Car', '/a/crossing.py:Car', 'crossing.py:Car'])
def test_a_path_is_no_module(name):
    assert refused(lambda: load_problem(name)) == (
        f"problem '{name}' cannot be loaded: give module:Class, a module's name, not a path, such "
        'as crossing:Car in the folder of crossing.py'
    )


@pytest.mark.parametrize('reasons_of', ASKED)
def test_ends_beyond_a_control_s_limit_are_named_in_its_unit(reasons_of):
    limits = {'control_limits': lambda s: {'ax': (-2.0, 30.0)}}
    (reason,) = reasons_of(changed(Driven, end=(0.0, 0.0, 40.0), **limits)())
    told = "the end violates the limit 'ax, highest' by 10 m/s^2, whatever the motion"
    assert reason.startswith(told)


@pytest.mark.parametrize(
    'rates',
    [
        lambda s, x, u: (x[2], x[3], *(u - s.drag * x[2:4])),
        lambda s, x, u: np.concatenate([x[2:4], u - s.drag * x[2:]]),
        lambda s, x, u: (*x[2:], *(u - np.array([[0.1], [0.1]]) * x[2:])),  # a column of numbers
    ],
)
def test_components_may_be_computed_at_once(rates):
    car = changed(Car, derivative=rates)()
    assert check_problem(car) == []
    assert car.solve().cost == pytest.approx(Car().solve().cost, rel=1e-4)


@dataclass(frozen=True)
class Weighed(Plain):
    """A field that is no parameter."""

    weight: float = 9.81


def test_a_field_that_is_no_parameter_is_told_to_be_one():
    given = {'weight': 3.0, 'mass': 2.0}
    assert refused(lambda: Weighed.from_parameters(given)) == (
        "parameter 'weight' is unknown to plain: it is a field without parameter(...)"
    )
    assert refused(lambda: Weighed.from_parameters({'start': 1.0})).endswith(
        'did you mean start.x?'
    )


@dataclass(frozen=True)
class Unset(DirectProblem):
    """A field without a default."""

    mass: float
    control_names, control_units = Plain.control_names, Plain.control_units
    state_names, state_units = Plain.state_names, Plain.state_units
    outputs = duration = invert = derivative = Car.final_cost


def test_a_field_without_a_default_is_told_to_have_one():
    told = 'Unset.mass has no default: declare it by parameter(...)'
    assert refused(lambda: Unset.from_parameters({})) == told


def test_the_group_solver_is_one_of_the_solver_s_parameters():
    @dataclass(frozen=True)
    class Own(Validated):
        deadline: float = parameter(1.0, 'time', unit='s', allowed=POSITIVE)

    @dataclass(frozen=True)
    class Solved(Cart):
        solver: Own = group(Own)

    @dataclass(frozen=True)
    class Counted(Cart):
        solver: int = 3

    for wrong in (Solved, Counted):
        assert "'solver' that is no group of SolverParameters: derive" in refused(wrong)

    @dataclass(frozen=True)
    class Made(Cart):
        solver: SolverParameters = field(default_factory=lambda: SolverParameters(deadline=1.0))

    assert Made().solve(counted=True).cost == pytest.approx(1.5, rel=1e-3)


def test_a_plan_with_other_controls_is_no_start_and_no_plan_of_a_problem():
    problem = Cart()
    plan = problem.solve(counted=True)
    one = plan.trajectory
    twice = replace(one, controls=np.tile(one.controls, 2), control_names=('u', 'w'), rates=None)
    found = problem.solve(counted=True, warm_start=replace(plan, trajectories={'cart': twice}))
    assert found.cost == pytest.approx(plan.cost, rel=1e-3)
    with pytest.raises(VerificationFailed, match="states or controls are not those of 'cart'"):
        problem.recovered({'cart': replace(one, control_names=('w',))})


def test_a_key_that_a_statement_s_own_table_lacks_is_not_taken_for_an_output():
    tabled = changed(Cart, invert=lambda s, y, z: (y['x'][:2], y['x'][2:] * {'gain': 1}['gian']))
    assert refused(tabled().solve).endswith(": 'gian'")
    for other in (
        lambda s, y, z: (y['y'][:2], y['x'][2:]),
        lambda s, y, z: (y[s.missing][:2], y['x'][2:]),
    ):
        told = refused(changed(Cart, invert=other, missing='y')().solve)
        assert told.endswith("'y' is in neither outputs() nor integrated()")


def test_functions_may_write_into_what_they_are_given():
    """Others got what one had changed, and were named for it."""

    def derivative(self, x, u):
        x[1] *= 2.0
        return 0.5 * x[1], u[0], u[1], 0.5 * x[1]

    def invert(self, y, z):
        place, speed, _ = y.pop('x')
        place -= 5.0
        z['way'] += 1.0
        return (place + 5.0, speed, y['yaw'][0], z['way'] - 1.0), (_, y['yaw'][1])

    def margins(self, t, x, u):
        t += 1.0
        x[0] -= 9.0
        return {'wall': 9.0 - x[0] + t}

    changing = changed(Driven, derivative=derivative, invert=invert, margins=margins)()
    assert check_problem(changing) == []
    found = [made.solve(counted=True).cost for made in (changing, Driven())]
    assert found[0] == pytest.approx(found[1], rel=1e-4)


@pytest.mark.parametrize('reasons_of', [check_problem, lambda made: made.solve()])
@pytest.mark.parametrize('name', ['state_names', 'state_units', 'reserve', 'nodes', 'starts'])
def test_what_a_property_of_a_statement_raises_is_told(name, reasons_of):
    """That of a reserve was taken for none."""
    failing = changed(Driven, **{name: property(lambda self: self.missing)})()
    message = refused(lambda: reasons_of(failing))
    assert message.startswith(f'{name} of Changed raises AttributeError in line ')
    assert message.endswith("Changed has no 'missing'")


@pytest.mark.parametrize(
    ('change', 'told'),
    [
        ({'joints': lambda s: {'arm': (('x', 'vx'), ('yaw', 'way'))}}, 'joints must give every'),
        (
            {'joints': lambda s: {'arm': ('x', ('vx', 'yaw'))}},
            "joints gives 'arm' the state '('vx",
        ),
        ({'joints': lambda s: {'arm': (s.way, 'vx')}}, 'joints of Changed raises AttributeError'),
        ({'feedback_weights': lambda s: 1 / 0}, 'feedback_weights of Changed raises ZeroDivision'),
    ],
)
def test_what_a_tracker_asks_a_statement_for_is_checked(change, told):
    assert refused(lambda: check_problem(changed(Driven, **change)())).startswith(told)


def test_a_state_that_invert_gives_another_sign_is_told_to_be_its():
    def invert(self, y, z):
        (x, *others), controls = Driven.invert(self, y, z)
        return (-x, *others), controls

    message = refused(changed(Driven, invert=invert)().solve)
    assert message.endswith('must begin with self.start.x, and invert give it')
