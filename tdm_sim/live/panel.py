# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The panel of the page: buttons, sliders, plots, and the nodes' status and log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from functools import partial
from html import escape
from itertools import cycle, groupby
import math
from pathlib import Path
import re
from typing import Any, NamedTuple

from tdm_planner.drawing import COLOURS, LIMIT
from tdm_sim.live.listener import Event
from tdm_sim.live.operations import Operations
from tdm_sim.live.rig import Chart
import viser

_HEIGHT = 150  # px of a plot
_LEVELS = {30: '#b26a00', 40: LIMIT, 50: LIMIT}  # colours of warnings and errors
_NAME = 'color: #888; padding-right: 0.8em; white-space: nowrap'
_SMALL = (
    'font-size: 0.8em; line-height: 1.35; padding: 0.3em 0.6em 0.8em; overflow-wrap: anywhere;'
)

WIDEST = 50.0  # times the value that a range may be as wide, to be shown whole
FIRST = ('limits', 'weights')  # groups of parameters

_SPREAD = 4.0  # of a slider over a wide range, in values: from 0 or a quarter of it on
_STEPS = 200
_DOUBLE, _INTEGER = 3, 2  # of rcl_interfaces/msg/ParameterType
_NOT_SHOWN = re.compile(r'(start\.(max_age|delay)|replan\.|solver\.|.*seed$|rate$)')


class Panel:
    """What stands beside the picture; made once, for all browsers."""

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        self._server, self._gui = server, server.gui
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width='large')
        gui.set_panel_label(title)
        gui.main_panel.dock_right()
        self._status = gui.add_html('')
        tabs = gui.add_tab_group()
        with tabs.add_tab('Drive'):
            self._drive()
        self._sliders_tab = tabs.add_tab('Parameters')
        self._plots_tab = tabs.add_tab('Plots')
        with tabs.add_tab('Events'):
            self._events = gui.add_html('')
        with self._plots_tab:
            self._vehicle: Any = gui.add_dropdown('vehicle', ['-'], visible=False)
        self._folders: list[Any] = []
        self._sliders: dict[str, Any] = {}
        self._reasons: dict[str, Any] = {}
        self._shown: dict[str, Slider] = {}
        self._charts: dict[tuple[str, ...], Any] = {}  # by title and names of curves

    def _drive(self) -> None:
        gui = self._gui
        self._plan = gui.add_button('Plan', color='green', hint='plan from the measured state')
        self._push = gui.add_button('Push', hint='one impulse; a body can be pulled at, too')
        self._reset = gui.add_button('Reset', hint='all simulated plants')
        self._replan: Any = gui.add_checkbox(
            'Replan on the way', False, hint='replan.rate of the planner: 5 Hz'
        )
        self._record = gui.add_button('Start a recording')
        self._report = gui.add_button('Make a report', disabled=True)
        self._note = gui.add_html('')

    def connect(self, operations: Operations, choose: Callable[[str], None]) -> None:
        """Connect the buttons and sliders; `choose` is told whose curves are to be shown."""
        self._operations = operations
        for button, act in (
            (self._plan, operations.plan),
            (self._push, operations.push),
            (self._reset, operations.reset),
            (self._record, operations.record),
            (self._report, lambda: operations.report(self._offer)),
        ):
            button.on_click(_of_a_browser(act))
        self._replan.on_update(_of_a_browser(lambda: operations.replan(self._replan.value)))
        self._vehicle.on_update(_of_a_browser(lambda: choose(self._vehicle.value)))

    def _offer(self, file: Path) -> None:
        self._server.send_file_download(file.name, file.read_bytes())

    def tell(self, lines: Iterable[tuple[str, str]], fault: str = '') -> None:
        """Show figures by name, and above them what is wrong."""
        rows = ''.join(
            f'<tr style="vertical-align: top"><td style="{_NAME}">{escape(name)}</td>'
            f'<td>{escape(value)}</td></tr>'
            for name, value in lines
        )
        above = f'<div class="tdm-fault" style="color: {LIMIT}">{escape(fault)}</div>'
        self._status.content = _block(
            'tdm-status', f'{above if fault else ""}<table>{rows}</table>'
        )

    def note(self, text: str) -> None:
        """Show the outcome of the last button."""
        self._note.content = _block('tdm-note', escape(text))

    def can(self, simulated: bool, recording: bool, recorded: bool) -> None:
        """Enable what is possible: pushes and resets are for simulated plants."""
        self._push.disabled = self._reset.disabled = not simulated
        self._record.label = 'End the recording' if recording else 'Start a recording'
        self._report.disabled = not recorded

    def replans(self, on: bool) -> None:
        """Show whether the planner replans."""
        self._replan.value = on

    def vehicles(self, names: Sequence[str]) -> None:
        """Offer the curves of these vehicles."""
        self._vehicle.visible = len(names) > 1
        self._vehicle.options = tuple(names)

    def events(self, events: Iterable[Event]) -> None:
        """Show what nodes have logged, the newest first."""
        rows = ''.join(
            f'<div style="color: {_LEVELS.get(level, "inherit")}"><span style="color: #888">'
            f'{datetime.fromtimestamp(instant):%H:%M:%S} {escape(node)}</span> '
            f'{escape(text)}</div>'
            for instant, level, node, text in events
        )
        self._events.content = _block('tdm-events', rows)

    # Sliders.

    def sliders(self, wanted: dict[str, Slider]) -> None:
        """Show these sliders, by name; where they are the same ones, their values."""
        if wanted.keys() != self._shown.keys():
            self._make(wanted.values())
        for name, slider in wanted.items():
            if name in self._shown and slider.value != self._shown[name].value:
                handle = self._sliders[name]
                handle.value = type(handle.value)(min(max(slider.value, handle.min), handle.max))
        self._shown = wanted

    def reason(self, name: str, text: str) -> None:
        """Show beside a slider why there is no plan with its value; '' removes it."""
        beside = self._reasons.get(name.rpartition('.')[0])
        if beside is not None:
            beside.content = _block('tdm-reason', escape(text), f'color: {LIMIT};')

    def _make(self, sliders: Iterable[Slider]) -> None:
        for folder in self._folders:
            folder.remove()
        self._folders, self._sliders, self._reasons = [], {}, {}
        with self._sliders_tab:
            ordered = sorted(sliders, key=lambda s: (not s.group.startswith(FIRST), s.group))
            for number, (group, found) in enumerate(groupby(ordered, lambda s: s.group)):
                folder = self._gui.add_folder(group or 'others', expand_by_default=number < 2)
                self._folders.append(folder)
                with folder:
                    for slider in found:
                        self._sliders[slider.name] = self._add(slider)
                    self._reasons[group] = self._gui.add_html('')

    def _add(self, slider: Slider) -> Any:
        name = slider.name.rpartition('.')[2]
        label = f'{name} [{slider.unit}]' if slider.unit else name
        handle = self._gui.add_slider(
            label, slider.low, slider.high, slider.step, slider.value, hint=slider.hint
        )

        def change() -> None:
            value = type(slider.value)(handle.value)
            self._operations.change(slider.name, value, partial(self.reason, slider.name))

        handle.on_update(_of_a_browser(change))
        return handle

    # Plots.

    def charts(self, charts: Sequence[Chart]) -> None:
        """Show these charts."""
        wanted = {(chart.title, *chart.curves, *chart.planned): chart for chart in charts}
        for key in self._charts.keys() - wanted.keys():
            self._charts.pop(key).remove()
        for key, chart in wanted.items():
            data = (chart.x, *chart.curves.values(), *chart.planned.values())
            if key in self._charts:
                self._charts[key].data = data
                continue
            with self._plots_tab:
                self._charts[key] = self._gui.add_uplot(
                    data,
                    _series(chart),
                    title=chart.title,
                    scales={'x': {'time': False}},
                    legend={'show': len(data) > 2},
                    height=_HEIGHT,
                )


def _series(chart: Chart) -> tuple[Any, ...]:
    colours = dict(zip(chart.curves, cycle(COLOURS), strict=False))
    dashed = {'width': 1.0, 'dash': [6, 4]}
    return (
        {'label': 's'},
        *({'label': name, 'stroke': colours[name], 'width': 1.5} for name in chart.curves),
        *({'label': f'{n}, planned', 'stroke': colours[n], **dashed} for n in chart.planned),
    )


def _block(name: str, content: str, style: str = '') -> str:
    return f'<div class="{name}" style="{style} {_SMALL}">{content}</div>'


def _of_a_browser(act: Callable[[], None]) -> Callable[[Any], None]:
    """Return a callback for changes made in a browser, not for those made by the program."""

    def callback(event: Any) -> None:
        if event.client is not None:
            act()

    return callback


class Slider(NamedTuple):
    """A parameter to be moved: its whole name, its interval, its unit and what it is."""

    name: str
    low: float
    high: float
    step: float
    value: float
    unit: str
    hint: str

    @property
    def group(self) -> str:
        """Return what it is shown among; '' for parameters without a group."""
        return self.name.rpartition('.')[0]


def slider_of(descriptor: Any, value: Any) -> Slider | None:
    """
    Return the slider of a parameter's descriptor and value; None where it has none.

    If the declared range is very wide, it covers a few times the value instead; there is none if
    that is the least allowed.
    """
    number = descriptor.type in (_DOUBLE, _INTEGER)
    if not number or descriptor.read_only or not isinstance(value, float | int):
        return None
    if _NOT_SHOWN.match(descriptor.name):
        return None
    whole = descriptor.type == _INTEGER
    declared = descriptor.integer_range if whole else descriptor.floating_point_range
    low, high = (
        (declared[0].from_value, declared[0].to_value) if declared else (-math.inf, math.inf)
    )
    if value == low and high - low > WIDEST:  # how large it may sensibly be is not known
        return None
    low, high = shown_range(float(value), float(low), float(high))
    step = (high - low) / _STEPS
    if whole:
        low, high, step = math.floor(low), math.ceil(high), max(1, round(step))
    text, _, unit = descriptor.description.rpartition(' [')
    if not text:
        text, unit = descriptor.description, ''
    hint = f'{descriptor.name}: {text}. {descriptor.additional_constraints}'.strip()
    return Slider(descriptor.name, low, high, step, value, unit.rstrip(']'), hint)


def shown_range(value: float, low: float, high: float) -> tuple[float, float]:
    """Return the interval that a slider covers, for a value and what is declared as allowed."""
    size = abs(value) or 1.0
    if high - low <= WIDEST * size:
        return low, high
    if value < 0.0 or low < 0.0:
        below, above = value - _SPREAD * size, value + _SPREAD * size
    else:
        below, above = (value / _SPREAD if value else 0.0), _SPREAD * size
    return max(low, below), min(high, above)
