# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What each topic, service and JSON key is: the words of the tables that are generated.

Which of them exist is asked of the code; one without a text here, or a text without one of them,
stops the generation.
"""

from __future__ import annotations

from collections.abc import Mapping

# By node (as in `tools.endpoints.SET_UPS`, without the plant) and name.
TOPICS: Mapping[tuple[str, str], str] = {
    ('planner', 'plan'): 'plans from the newest measured state, or from `start.*`',
    ('planner', 'plan_with'): 'the same with parameters for this request alone',
    ('planner', 'joint_states'): 'state of the pendulum: joints `pendulum`, `disk`',
    ('planner', 'tracker_status'): 'the status of every plan',
    ('planner', '<robot>/tracker_status'): "the status of every plan of a robot's tracker",
    ('planner', '<robot>/joint_states'): 'joints `thruster`, `reaction_wheel` of a robot',
    ('planner', '<robot>/odom'): 'pose and velocity of a robot in the frame `arena`',
    ('planner', 'active_trajectory'): 'the active plan of the tracker, for a restarted planner',
    ('planner', '<robot>/active_trajectory'): "the active plan of a robot's tracker",
    ('planner', '<robot>/goal_pose'): (
        "moves the robot's place in the formation and asks for a plan"
    ),
    ('planner', 'trajectory'): 'the active plan for the pendulum',
    ('planner', '<robot>/trajectory'): (
        'the active plan for a robot: pose, thruster, wheel; rates, thrust and torque'
    ),
    ('planner', '<robot>/path'): 'planned path, every pose stamped',
    ('planner', 'markers'): 'the active plan: paths, goals, safety circles',
    ('planner', 'plant_markers'): 'a real plant in its measured state',
    ('planner', '<robot>/plant_markers'): (
        'a real plant in its measured state; goals that were rejected'
    ),
    ('planner', 'plan_summary'): (
        'one line of JSON: figures, worst margins with their instants, parameters of the '
        'active plan'
    ),
    ('planner', '/diagnostics'): 'state, figures of the last plan, worst margins',
    ('tracker', 'trajectory'): 'the plan to follow',
    ('tracker', 'joint_states'): 'measured joints',
    ('tracker', 'odom'): 'measured pose and velocity of a robot',
    ('tracker', 'plan'): 'requests a new plan, with `replan.on_deviation`',
    ('tracker', 'joint_command'): (
        "effort of `disk` [N m]; or thrust [N], its direction's rate [rad/s] and wheel torque "
        '[N m]'
    ),
    ('tracker', 'tracking_error'): 'measured less planned; efforts: the feedback',
    ('tracker', 'tracker_status'): 'the status of every plan, `goal_info.stamp` its start',
    ('tracker', 'active_trajectory'): (
        'the plan accepted last, as it came; without points when it is dropped'
    ),
    ('tracker', '/diagnostics'): 'phase, errors, ages',
    ('pendulum_plant', 'joint_command'): 'the torque of `disk` [N m]',
    ('pendulum_plant', 'joint_states'): 'joints `pendulum`, `disk`: angle, rate, torque',
    ('pendulum_plant', 'plant_markers'): 'the rig in motion, while a viewer subscribes',
    ('pendulum_plant', 'robot_description'): 'URDF of the pendulum',
    ('pendulum_plant', '/clock'): 'simulated time, with `publish_clock`',
    ('pendulum_plant', 'reset'): 'back to the initial state',
    ('pendulum_plant', 'push'): 'one impulse of `disturbance.impulse`',
    ('pendulum_plant', '/diagnostics'): 'time-outs, ignored commands, resets',
    ('robot_plant', 'joint_command'): 'thrust, its direction and rate, wheel torque',
    ('robot_plant', 'joint_states'): 'joints `thruster`, `reaction_wheel`',
    ('robot_plant', 'odom'): 'pose and velocity in the frame `arena`',
    ('robot_plant', 'plant_markers'): 'the robot in motion, while a viewer subscribes',
    ('robot_plant', '/clock'): 'simulated time, with `publish_clock`',
    ('robot_plant', 'reset'): 'back to the initial state',
    ('robot_plant', 'push'): 'one impulse of `disturbance.impulse`',
    ('robot_plant', '/diagnostics'): 'time-outs, ignored commands, resets',
}

# By dotted key; `*` stands for names that depend on the problem.
JSON_KEYS: Mapping[str, str] = {
    'plan_id': 'number of the plan, from 1, counted by the planner',
    'stamp.sec': 'instant at which the motion starts: seconds since the epoch',
    'stamp.nanosec': 'and nanoseconds',
    'problem': "the problem's registered name",
    'duration': 'from the start to the (last) arrival [s]',
    'cost': 'performance index J',
    'cost_terms.*': 'weighted terms that make up the cost',
    'penalty': 'violation left by the search, Delta of (10): of robots a weighted sum of squares,'
    ' else the largest; `verification` is the check',
    'solve_time': 'time spent searching [s]',
    'evaluations': 'motions computed during the search',
    'summary': 'one sentence for people',
    'code': 'why there is no plan: one of the codes below',
    'reason': 'the same in one sentence',
    'times': 'instants of the samples, from 0, strictly increasing [s]',
    'states.*': 'a state at the samples',
    'controls.*': 'a control at the samples',
    'interpolation': 'how controls run between samples: zero_order_hold, linear or cubic',
    'units.*': 'unit of a state or control',
    'rates.*': "a state's rates at the start and at the end of every interval; {} if not known",
    'robots.*': 'the plan of one robot, with the keys of a plan of a single vehicle',
    'vehicles.*.duration': 'until the arrival of one vehicle [s]',
    'vehicles.*.interpolation': 'how its controls run between samples',
    'vehicles.*.units.*': 'unit of a state or control',
    'vehicles.*.states': 'names of the states, in order',
    'vehicles.*.controls': 'names of the controls, in order',
    'vehicles.*.joints.*': (
        'states and controls that are `position`, `velocity` and `effort` of a joint'
    ),
    'verification.ok': 'whether the goal is reached and every limit kept; true in every plan',
    'verification.terminal_error.*': 'replayed final state less goal',
    'verification.worst.*': 'smallest margin of a limit; negative would be a violation',
    'verification.worst_times.*': 'instant of that margin [s]',
    'verification.units.*': 'unit of that margin',
    'verification.reasons': 'sentences about what failed; empty in every plan',
    'parameters.*': "the problem's parameters by dotted name",
}

# What each executable is for, where the table of them stands.
EXECUTABLES: Mapping[str, str] = {
    'planner': 'plans on request and publishes what was verified',
    'tracker': 'keeps one plant on its plan and holds it at the goal',
    'pendulum_plant': 'simulates the rotary pendulum in real time',
    'plant': 'simulates any stated problem in real time',
    'robot_plant': 'simulates one floating robot in real time',
    'tdm': 'plans once or many times, runs the demo, serves a live page, records, reports',
}
