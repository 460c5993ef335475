# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The ``tdm`` command: check, plan and study without ROS, run the demo, a live page, record, report.

Exit status: 0 done; 1 a demo failed or missed its goal, or a recording is incomplete; 2 wrong
usage or invalid problem; 3 no plan; 129, 130, 143 ended by SIGHUP, SIGINT or SIGTERM. Recordings
and live pages end by such a signal, with 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
import sys
from typing import Any
import webbrowser

from tdm_planner import __version__
from tdm_planner.exceptions import Infeasible, InvalidProblem, TdmError
from tdm_planner.parameter_files import read_parameters
from tdm_planner.plan_files import check_path, plan_document, save_plan, UnusableFile
from tdm_planner.plants.compilation import report_compilation
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import check_file_is_for, load_problem, SHORT_NAMES
from tdm_planner.starting import ignore_signals, Interrupted, interruptible, NO_ROS, started_as
from tdm_sim.progress import printing, Progress

EXTRAS = dict.fromkeys(('dask', 'distributed', 'pyarrow'), 'study') | {'viser': 'live'}

EXIT_DONE, EXIT_MISSED, EXIT_USAGE, EXIT_NO_PLAN = 0, 1, 2, 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    options.done = options.run is _live  # so that a signal ends it as it should
    run: Callable[[argparse.Namespace], int] = options.run
    try:
        with interruptible():
            return run(options)
    except TdmError as error:
        _say(f'{error.code}: {error}')
        return EXIT_NO_PLAN if isinstance(error, Infeasible) else EXIT_USAGE
    except ImportError as error:
        _say(_what_is_missing(error))
        return EXIT_USAGE
    except OSError as error:
        if error.filename is None:
            raise
        _say(f"{UnusableFile.code}: '{error.filename}' cannot be used: {error.strerror}")
        return EXIT_USAGE
    except Interrupted as interrupted:
        return EXIT_DONE if options.done else interrupted.code
    finally:
        if started_as() == 'tdm':
            ignore_signals()  # what there was to do is done, and the process about to end


def _what_is_missing(error: ImportError) -> str:
    """Say how to get ROS 2, or the packages of an extra; others' errors are passed on."""
    if not isinstance(error, ModuleNotFoundError):
        return str(error)  # ROS 2 is there twice, see starting.require_one_ros
    name = (error.name or '').partition('.')[0]
    if name in EXTRAS:
        return (
            f"this needs '{name}', which is not installed: run 'make setup' in the source tree, "
            f"or 'pip install tdm_planner[{EXTRAS[name]}]'"
        )
    if name != 'rclpy':
        raise error
    return NO_ROS


def _say(text: str) -> None:
    print(f'tdm: {text}', file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='tdm', description=__doc__.strip().split('\n')[0].replace('`', '')
    )
    file, quiet, view = (argparse.ArgumentParser(add_help=False) for _ in range(3))
    file.add_argument('--params', type=Path, metavar='FILE.yaml', help='ROS 2 parameter file')
    problem = argparse.ArgumentParser(add_help=False, parents=[file])
    problem.add_argument(
        'problem',
        type=lambda name: SHORT_NAMES.get(name, name),
        help='pendulum, robots, an installed problem, module:Class',
    )
    problem.add_argument(
        '--set',
        nargs='+',
        action='extend',
        default=[],
        metavar='NAME=VALUE',
        help='parameters; may be given several times',
    )
    quiet.add_argument(
        '-q', '--quiet', action='store_true', help="print only errors and a demo's verdict"
    )
    view.add_argument('--view', action='store_true', help='show the page in the browser')
    parser.add_argument('--version', action='version', version=f'tdm_planner {__version__}')
    commands = parser.add_subparsers(required=True, metavar='COMMAND')

    def add(run: Callable[[argparse.Namespace], int], text: str, *parents: Any) -> Any:
        made = commands.add_parser(
            run.__name__.strip('_'), parents=parents, help=text, description=text
        )
        made.set_defaults(run=run)
        return made

    plan = add(_plan, 'plan without ROS running and write the plan', problem, quiet)
    plan.add_argument(
        '-o', '--output', type=Path, required=True, metavar='FILE', help='.json, .csv or .npz'
    )
    plan.add_argument('--plot', type=Path, metavar='FILE', help='.png, .pdf or .svg')

    add(_check, 'check the equations of a stated problem, and its limits at both ends', problem)

    text = (
        'run planner, tracker and plant as nodes, record them, judge whether the goal was reached'
    )
    demo = add(_demo, text, file, view, quiet)
    demo.add_argument('plant', help='pendulum, robots, a stated problem: module:Class or its name')
    demo.add_argument('-o', '--output', type=Path, metavar='DIR', help='default: ./PLANT')
    demo.add_argument(
        '--speed',
        type=float,
        default=1.0,
        metavar='FACTOR',
        help='speed of simulated time relative to real time; default: 1',
    )

    live = add(_live, 'show nodes in the browser; drag goals, push plants, set parameters', file)
    live.add_argument(
        'nodes',
        nargs='?',
        default='/',
        metavar='NAMESPACE | PLANT',
        help='namespace of the nodes to show, default /; or pendulum, robots, a stated problem: '
        'its nodes are started unless they run already',
    )
    live.add_argument(
        '-o',
        '--output',
        type=Path,
        default=Path('live'),
        metavar='DIR',
        help='folder of recordings and reports; default: live',
    )
    live.add_argument(
        '--host', default='127.0.0.1', help='address to serve on; default: this computer only'
    )
    live.add_argument(
        '--port',
        type=_number(0, 65535),
        default=8080,
        help='port to serve on, or the next one that is free; default: 8080',
    )
    live.add_argument('--no-browser', action='store_true', help='do not open the browser')

    record = add(_record, 'record topics to a rosbag2', quiet)
    record.add_argument('topics', nargs='*', metavar='TOPIC', help='default: all')
    record.add_argument('-o', '--output', type=Path, required=True, metavar='BAG')
    record.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    record.add_argument(
        '--namespace',
        metavar='NAME',
        help='record the topics of this namespace, and shared ones such as /clock and /tf',
    )

    report = add(_report, 'one HTML page on a recording or a plan', view, quiet)
    report.add_argument('source', type=Path, metavar='BAG|PLAN', help='rosbag2 or plan.json')
    report.add_argument(
        '-o', '--output', type=Path, default=Path('report.html'), metavar='FILE.html'
    )
    report.add_argument(
        '--namespace', metavar='NAME', help='of the planner, where a recording has several'
    )
    report.add_argument(
        '--problem', metavar='module:Class', help='class of the problem if it is not installed'
    )

    study = add(_study, 'plan many times, over ranges of parameters', problem, view, quiet)
    study.add_argument(
        '--over',
        action='append',
        required=True,
        metavar='NAME=RANGE',
        help="LOW:HIGH:N, 'LOW:HIGH:log N', 'LOW:HIGH:random N' or VALUE,VALUE,...; may be given "
        'several times, for all combinations',
    )
    study.add_argument('-o', '--output', type=Path, required=True, metavar='DIR')
    study.add_argument(
        '--closed-loop', action='store_true', help='simulate every plan with feedback'
    )
    study.add_argument(
        '--mismatch',
        type=float,
        metavar='SHARE',
        help="largest relative error of the simulated plant's constants",
    )
    study.add_argument(
        '--seeds', type=int, metavar='N', help='simulations of every plan; default: 1'
    )
    study.add_argument('--scheduler', metavar='HOST:PORT', help='Dask scheduler to use')
    study.add_argument(
        '--processes',
        type=_number(1, 1000),
        metavar='N',
        help='processes on this machine; default: one a core',
    )
    study.add_argument('--csv', action='store_true', help='write table.csv, not table.parquet')
    return parser


def _number(least: int, most: int) -> Callable[[str], int]:
    """Return the type of an option that is an integer in [least, most]."""

    def number(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f'must be an integer in [{least}, {most}]')
        return int(text)

    return number


def _problem(options: argparse.Namespace) -> Problem:
    problem_class = load_problem(options.problem)
    return problem_class.from_parameters(_parameters(options))


def _parameters(options: argparse.Namespace) -> dict[str, Any]:
    values = read_parameters(options.params, options.set)
    check_file_is_for(options.problem, values, options.params)
    return values


def _plan(options: argparse.Namespace) -> int:
    from tdm_planner.plant_views import view_of
    from tdm_planner.problems.direct.problem import misspelled_attributes

    check_path(options.output)
    if options.plot is not None:
        check_path(options.plot, ('.png', '.pdf', '.svg'))
    problem = _problem(options)
    for doubt in misspelled_attributes(type(problem)).values():
        _say(doubt)
    with Progress(options.quiet) as progress:
        report_compilation(progress.line)
        progress.phase('preparing')
        problem.prepare()
        view_of(problem).check_drawing()
        progress.phase('planning')
        solution = problem.solve()
        save_plan(plan_document(problem, solution), options.output)
        if options.plot is not None:
            progress.phase(f'drawing {options.plot}')
            # matplotlib takes half a second to import and only plots need it
            from tdm_sim.report.plotting import plot_solution

            plot_solution(problem, solution, options.plot)
    progress.line(solution.summary or f'{solution.problem}: J = {solution.cost:.4g}')
    also = f' and {options.plot}' if options.plot else ''
    progress.line(f'written to {options.output}{also}')
    return EXIT_DONE


def _check(options: argparse.Namespace) -> int:
    from rich.console import Console
    from tdm_planner.problem_check import check_problem

    problem = _problem(options)
    reasons = None
    with printing():
        reasons = check_problem(problem, Console(markup=False))  # names are as they are
    if reasons is None:  # the rest is not read, but the exit status counts
        reasons = check_problem(problem)
    for reason in reasons:
        _say(f'INVALID_PROBLEM: {reason}')
    return EXIT_USAGE if reasons else EXIT_DONE


def _demo(options: argparse.Namespace) -> int:
    from tdm_sim.demo import DemoFailed, run_demo
    from tdm_sim.processes import ProcessFailed

    output = options.output or Path(options.plant.rpartition(':')[2].lower())
    try:
        reached = run_demo(options.plant, output, options.params, options.quiet, options.speed)
    except (DemoFailed, ProcessFailed) as error:
        _say(f'{error.code}: {error}')
        return EXIT_MISSED
    if options.view and (output / 'report.html').is_file():
        _show(output / 'report.html')
    return EXIT_DONE if reached else EXIT_MISSED


def _live(options: argparse.Namespace) -> int:
    from tdm_sim.live.run import run_live

    run_live(
        options.nodes,
        options.output,
        parameters=options.params,
        host=options.host,
        port=options.port,
        browser=not options.no_browser,
    )
    return EXIT_DONE


def _record(options: argparse.Namespace) -> int:
    from tdm_sim.recorder import IncompleteRecording, record

    given = options.output, options.topics, options.storage, options.namespace
    try:
        with Progress(options.quiet) as progress:
            done = record(*given, progress)
            options.done = True
    except IncompleteRecording as error:
        _say(f'{error.code}: {error}')
        return EXIT_MISSED
    progress.line(
        f'{done.messages} messages in {done.elapsed:.1f} s written to {options.output}, '
        f'{done.dropped} dropped'
    )
    for topic, count in sorted(done.counts.items()):
        progress.line(f'  {count:8d}  {topic}')
    return EXIT_DONE


def _report(options: argparse.Namespace) -> int:
    from tdm_sim.report.page import write_report
    from tdm_sim.report.reader import read_mission

    check_path(options.output, ('.html', '.htm'))
    with Progress(options.quiet) as progress:
        progress.phase(f'reading {options.source}')
        problem = None if options.problem is None else load_problem(options.problem)
        mission = read_mission(options.source, options.namespace, problem)
        progress.phase(f'writing {options.output}')
        write_report(mission, options.output)
    progress.line(f'written to {options.output}')
    if options.view:
        _show(options.output)
    return EXIT_DONE


def _study(options: argparse.Namespace) -> int:
    from tdm_sim.study import ClosedLoop, parse_axis, run
    from tdm_sim.study.pictures import PAGE

    asked = {'seeds': options.seeds, 'mismatch': options.mismatch}
    given = {name: value for name, value in asked.items() if value is not None}
    if given and not options.closed_loop:
        raise InvalidProblem(f"'--{next(iter(given))}' needs '--closed-loop'")
    with Progress(options.quiet) as progress:
        run(
            options.problem,
            [parse_axis(text) for text in options.over],
            options.output,
            parameters=_parameters(options),
            closed_loop=ClosedLoop(**given) if options.closed_loop else None,
            scheduler=options.scheduler,
            processes=options.processes,
            ending='.csv' if options.csv else '.parquet',
            progress=progress,
        )
    progress.line(f'written to {options.output}: {PAGE}, table, pictures')
    if options.view:
        _show(options.output / PAGE)
    return EXIT_DONE


def _show(page: Path) -> None:
    webbrowser.open(page.resolve().as_uri())


if __name__ == '__main__':
    sys.exit(main())
