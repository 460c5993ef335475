# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The demo: nodes as processes, a plan by service, a recording, a verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import math
import os
from pathlib import Path
import shutil
import sys
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from std_srvs.srv import Trigger
from tdm_planner.exceptions import NoState, TdmError
from tdm_planner.nodes.reading import Level
from tdm_planner.parameters import ParameterSpec, Range
from tdm_planner.plan_files import make_folder, save_plan, UnusableFile, VEHICLE_FIGURES
from tdm_planner.starting import uninterrupted
from tdm_sim.processes import make_scene, NodeProcesses, nodes_run, Scene
from tdm_sim.progress import printing, Progress
from tdm_sim.report.comparison import compare, Comparison
from tdm_sim.report.mission import Mission
from tdm_sim.report.page import write_report
from tdm_sim.report.reader import read_mission
from tdm_sim.report.tables import figures

SPEED = ParameterSpec(
    'speed', float, 1.0, 'simulated time relative to real time', range=Range(0.05, 10.0)
)

_START_LIMIT = 60.0  # s for every node to be up and connected
_ANSWER_LIMIT = 300.0  # s for the planner to answer: it may have to compile its kernels
_POLL_PERIOD = 0.05  # s between looks at the processes, at what is awaited, and of the live line
_RETRY = 0.2  # s between requests while states are on their way
_SETTLED = 0.1  # s after a reset, when the planner has received states from after it
_SILENCE = 30.0  # s without a state, after which the demo ends
_LATE = 'older than state_timeout'  # as trackers say it
_OWN_FILES = ('bag/metadata.yaml', 'bag/*.mcap', 'log/*.log', 'plan.json', 'report.html')
_MARK = 'log/recorder.log'  # every demo begins with it; a bag, plan and report others write, too
_OF_MESSAGES = ('plan_id', 'stamp', 'vehicles')  # what a plan's summary has, and its file has not

Wait = Callable[[Callable[[], bool], float], bool]


class DemoFailed(TdmError):
    """The demo failed; the message names the part that did not start or answer."""

    code = 'DEMO_FAILED'


class NamespaceTaken(TdmError):
    """Nodes run in the demo's namespace already: it has not begun."""

    code = DemoFailed.code


def run_demo(
    plant: str,
    output: Path,
    parameters: Path | None = None,
    quiet: bool = False,
    speed: float = 1.0,
) -> bool:
    """
    Run the demo of a plant and leave bag, plan and report in `output`.

    Simulated time runs `speed` times as fast as real time. Returns whether the goal was reached
    and held without a violated limit. Raise InvalidProblem if file or folder cannot be used,
    NamespaceTaken if nodes run in its namespace already, DemoFailed or ProcessFailed if a node did
    not come up, ended, or did not answer.
    """
    scene = make_scene(plant, parameters)
    scene.speed = SPEED.check(speed)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    if nodes_run(scene.namespace):
        raise NamespaceTaken(
            f'nodes run in {scene.namespace} already: end them, or set another ROS_DOMAIN_ID'
        )
    _prepare_folder(output)
    with Progress(quiet) as progress:
        unclean = _conduct(scene, output, progress)
        progress.phase(f'reading {output}/bag')
        mission = read_mission(output / 'bag', scene.namespace, type(scene.problem))
        comparison = compare(mission)
        progress.phase(f'writing {output}/plan.json and {output}/report.html')
        if mission.figures and all(vehicle.plan for vehicle in mission.vehicles):
            save_plan(_plan_file(mission), output / 'plan.json')
        write_report(mission, output / 'report.html', comparison)
    judged = comparison.verdict
    table = _table(comparison)
    with printing():
        Console(highlight=False).print(table.title if quiet else table)
    progress.line(f'recorded to {output}/bag, report in {output}/report.html')
    told = _unjudged(mission) if judged is None else (*judged.reasons, judged.undecided)
    done = judged is not None and judged.reached and not unclean
    advice = '' if done else _advice(mission, scene.speed)
    for reason in filter(None, (*told, *unclean, advice)):
        print(f'tdm demo: {reason}', file=sys.stderr)
    return done


def _unjudged(mission: Mission) -> tuple[str, ...]:
    """Say what there is no verdict for: what is missing, and the last error of a node."""
    errors = [f'{e.source}: {e.text}' for e in mission.events if e.level >= Level.ERROR]
    return 'too little was recorded to judge it', *mission.missing, *errors[-1:]


def _advice(mission: Mission, speed: float) -> str:
    """Say what helps where states came too late during the motion."""
    late = sum(_LATE in e.text for e in mission.events if not mission.is_early(e))
    slower = max(speed / 2.0, SPEED.range.lower)
    if not late or slower == speed:
        return ''
    return (
        f"states came too late ({_LATE}) {late} times: '--speed {slower:g}' gives them more time"
    )


def _prepare_folder(folder: Path) -> None:
    """Clear the files of an earlier demo; reject a folder that holds anything else."""
    if folder.exists() and not folder.is_dir():
        raise UnusableFile(f"'{folder}' is a file, not a folder for the demo")
    make_folder(folder)
    found = {path for path in folder.rglob('*') if path.is_symlink() or not path.is_dir()}
    own = {path for names in _OWN_FILES for path in folder.glob(names)} & found
    others = sorted(found - own if (folder / _MARK) in own else found)
    if others:
        raise UnusableFile(
            f"the folder '{folder}' holds '{others[0].relative_to(folder)}', which may not be a "
            "demo's: name another one with -o"
        )
    for path in own:
        path.unlink()
    if (folder / 'bag').is_dir():
        shutil.rmtree(folder / 'bag')  # empty: a bag is a new folder


def _conduct(scene: Scene, output: Path, progress: Progress) -> list[str]:
    """Run the demo; returns the nodes that did not end cleanly."""
    with Context() as context, NodeProcesses(output / 'log') as processes:
        node = rclpy.create_node(
            'demo', namespace=scene.namespace, context=context, start_parameter_services=False
        )
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        scene.listen(node)

        def wait(until: Callable[[], bool], limit: float = math.inf) -> bool:
            end = time.monotonic() + limit
            while not until():
                if time.monotonic() > end:
                    return False
                processes.check()
                progress.update(scene.status())
                look = time.monotonic() + _POLL_PERIOD
                # rclpy prints a traceback for every task that a signal interrupts.
                with uninterrupted():
                    while (left := look - time.monotonic()) > 0.0:
                        executor.spin_once(timeout_sec=left)
            return True

        nodes = scene.nodes()
        progress.phase('starting ' + ', '.join(name for name, _, _ in nodes))
        words = ['record', '-o', f'{output}/bag', '--namespace', scene.namespace, '--quiet']
        for name, module, arguments in [('recorder', 'tdm_planner.cli', words), *nodes]:
            processes.start(name, module, arguments)
        if not wait(lambda: not scene.missing(), _START_LIMIT):
            missing = ', '.join(scene.missing())
            raise DemoFailed(f'not up and connected after {_START_LIMIT:g} s: {missing}')
        progress.phase('asking for a plan')
        progress.phase(_ask(scene, wait)['summary'])
        if not wait(lambda: scene.planned, _ANSWER_LIMIT):
            raise DemoFailed('the planner answered, but no plan was published')
        wait(lambda: scene.over or time.monotonic() - scene.heard_at > _SILENCE)
        progress.phase('ending the nodes')
        codes = processes.end()
        node.destroy_node()
    return [f'{name} ended with exit code {code}' for name, code in codes.items() if code]


def _ask(scene: Scene, wait: Wait) -> dict[str, Any]:
    """
    Request a plan of plants that begin, again while the planner has not received their states.

    Those that move by themselves have gone far away while the nodes came up.
    """
    end = time.monotonic() + _START_LIMIT
    while True:
        _reset(scene, wait)
        (response,) = _call(scene, [f'{scene.namespace}/planner'], wait)
        answer: dict[str, Any] = json.loads(response.message)
        if response.success:
            return answer
        if answer['code'] != NoState.code or time.monotonic() > end:
            raise DemoFailed(f'no plan: {answer["code"]}: {answer["reason"]}')
        wait(lambda: False, _RETRY)


def _reset(scene: Scene, wait: Wait) -> None:
    """Put the plants back to where they begin, and wait until the planner can know."""
    _call(scene, [plant.name for plant in scene.plants], wait)
    settled = scene.now + _SETTLED
    wait(lambda: scene.now >= settled, _START_LIMIT)


def _call(scene: Scene, nodes: Sequence[str], wait: Wait) -> list[Any]:
    """Return the answers of nodes' services."""
    answers = {name: scene.clients[name].call_async(Trigger.Request()) for name in nodes}
    if not wait(lambda: all(answer.done() for answer in answers.values()), _ANSWER_LIMIT):
        late = ', '.join(name for name, answer in answers.items() if not answer.done())
        raise DemoFailed(f'no answer within {_ANSWER_LIMIT:g} s: {late}')
    return [answer.result() for answer in answers.values()]


def _plan_file(mission: Mission) -> dict[str, Any]:
    """Return the plan that counts at the end, as published and with the planner's figures."""
    document = {k: v for k, v in mission.figures[-1].document.items() if k not in _OF_MESSAGES}
    plans = {v.name: v.plan.trajectory for v in mission.vehicles if v.plan is not None}
    if len(mission.vehicles) == 1:
        return document | next(iter(plans.values())).to_dict()
    head = {key: document[key] for key in VEHICLE_FIGURES}
    robots = {name: {**head, 'duration': p.duration, **p.to_dict()} for name, p in plans.items()}
    return document | {'robots': robots}


def _table(comparison: Comparison) -> Table:
    judged = comparison.verdict
    table = Table('', title='not known' if judged is None else judged.title.lower())
    for heading in ('planned', 'achieved'):
        table.add_column(heading, justify='right')
    for row in figures(comparison):
        table.add_row(*map(escape, row))
    return table
