# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The panel of the page: buttons, sliders, plots, and the nodes' status and log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
import html
from typing import Any, Protocol

from tdm_planner.drawing import COLOURS, LIMIT
from tdm_sim.live.history import Chart
from tdm_sim.live.listener import Event
from tdm_sim.live.sliders import Slider
import viser

_HEIGHT = 150  # px of a plot
_LEVELS = {30: '#b26a00', 40: LIMIT, 50: LIMIT}  # colours of warnings and errors
_NAME = 'color: #888; padding-right: 0.8em; white-space: nowrap'
_SMALL = (
    'font-size: 0.8em; line-height: 1.35; padding: 0.3em 0.6em 0.8em; overflow-wrap: anywhere;'
)


class Actions(Protocol):
    """The operations of the page; called in threads of the server."""

    def plan(self) -> None:
        """Make a plan."""

    def push(self) -> None:
        """Push the vehicle that is shown."""

    def reset(self) -> None:
        """Put all plants back into their initial states."""

    def replan(self, on: bool) -> None:
        """Switch replanning on or off."""

    def change(self, slider: Slider, value: float) -> None:
        """Give a parameter a value."""

    def choose(self, vehicle: str) -> None:
        """Show the curves of another vehicle."""

    def record(self) -> None:
        """Begin a recording, or end it."""

    def report(self) -> None:
        """Make a report on the last recording."""


class Panel:
    """What stands beside the picture; made once, for all browsers."""

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        self._gui = server.gui
        self._actions: Actions
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
        self._charts: dict[str, tuple[tuple[str, ...], Any]] = {}

    def _drive(self) -> None:
        gui = self._gui
        self._buttons = {
            'Plan': gui.add_button('Plan', color='green', hint='plan from the measured state'),
            'Push': gui.add_button('Push', hint='one impulse; a body can be pulled at, too'),
            'Reset': gui.add_button('Reset', hint='all simulated plants'),
        }
        self._replan: Any = gui.add_checkbox(
            'Replan on the way', False, hint='replan.rate of the planner: 5 Hz'
        )
        self._record = gui.add_button('Start a recording')
        self._report = gui.add_button('Make a report', disabled=True)
        self._note = gui.add_html('')

    def connect(self, actions: Actions) -> None:
        """Connect the buttons and sliders."""
        self._actions = actions
        for button, act in (
            (self._buttons['Plan'], actions.plan),
            (self._buttons['Push'], actions.push),
            (self._buttons['Reset'], actions.reset),
            (self._record, actions.record),
            (self._report, actions.report),
        ):
            button.on_click(_of_a_browser(act))
        self._replan.on_update(_of_a_browser(lambda: actions.replan(self._replan.value)))
        self._vehicle.on_update(_of_a_browser(lambda: actions.choose(self._vehicle.value)))

    def tell(self, lines: Iterable[tuple[str, str]], fault: str = '') -> None:
        """Show figures by name, and above them what is wrong."""
        rows = ''.join(
            f'<tr style="vertical-align: top"><td style="{_NAME}">{_text(name)}</td>'
            f'<td>{_text(value)}</td></tr>'
            for name, value in lines
        )
        above = (
            f'<div class="tdm-fault" style="color: {LIMIT}">{_text(fault)}</div>' if fault else ''
        )
        self._status.content = (
            f'<div class="tdm-status" style="{_SMALL}">{above}<table>{rows}</table></div>'
        )

    def note(self, text: str) -> None:
        """Show the outcome of the last button."""
        self._note.content = f'<div class="tdm-note" style="{_SMALL}">{_text(text)}</div>'

    def can(self, simulated: bool, recording: bool, recorded: bool) -> None:
        """Enable what is possible: pushes and resets are for simulated plants."""
        self._buttons['Push'].disabled = self._buttons['Reset'].disabled = not simulated
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
        rows = []
        for instant, level, node, text in events:
            when = f'{datetime.fromtimestamp(instant):%H:%M:%S}'
            colour = _LEVELS.get(level, 'inherit')
            rows.append(
                f'<div style="color: {colour}"><span style="color: #888">{when} {_text(node)}'
                f'</span> {_text(text)}</div>'
            )
        self._events.content = f'<div class="tdm-events" style="{_SMALL}">{"".join(rows)}</div>'

    # Sliders.

    def sliders(self, groups: Mapping[str, Sequence[Slider]]) -> None:
        """Show these sliders; where they are the same ones, their values."""
        wanted = {slider.name: slider for found in groups.values() for slider in found}
        if wanted.keys() != self._shown.keys():
            self._make(groups)
        for name, slider in wanted.items():
            if name in self._shown and slider.value != self._shown[name].value:
                handle = self._sliders[name]
                handle.value = type(handle.value)(min(max(slider.value, handle.min), handle.max))
        self._shown = wanted

    def reason(self, name: str, text: str) -> None:
        """Show beside a slider why there is no plan with its value; '' removes it."""
        beside = self._reasons.get(name.rpartition('.')[0])
        if beside is not None:
            beside.content = (
                f'<div class="tdm-reason" style="color: {LIMIT}; {_SMALL}">{_text(text)}</div>'
            )

    def _make(self, groups: Mapping[str, Sequence[Slider]]) -> None:
        for folder in self._folders:
            folder.remove()
        self._folders, self._sliders, self._reasons = [], {}, {}
        with self._sliders_tab:
            for number, (group, sliders) in enumerate(groups.items()):
                folder = self._gui.add_folder(group or 'others', expand_by_default=number < 2)
                self._folders.append(folder)
                with folder:
                    for slider in sliders:
                        self._sliders[slider.name] = self._add(slider)
                    self._reasons[group] = self._gui.add_html('')

    def _add(self, slider: Slider) -> Any:
        name = slider.name.rpartition('.')[2]
        label = f'{name} [{slider.unit}]' if slider.unit else name
        handle = self._gui.add_slider(
            label, slider.low, slider.high, slider.step, slider.value, hint=slider.hint
        )
        handle.on_update(_of_a_browser(lambda: self._actions.change(slider, handle.value)))
        return handle

    # Plots.

    def charts(self, charts: Sequence[Chart]) -> None:
        """Show these charts."""
        for title in self._charts.keys() - {chart.title for chart in charts}:
            self._charts.pop(title)[1].remove()
        for chart in charts:
            names = tuple(chart.curves)
            data = (chart.x, *chart.curves.values())
            known = self._charts.get(chart.title)
            if known is not None and known[0] == names:
                known[1].data = data
                continue
            if known is not None:
                known[1].remove()
            with self._plots_tab:
                handle = self._gui.add_uplot(
                    data,
                    _series(chart),
                    title=chart.title,
                    scales={'x': {'time': False}},
                    legend={'show': len(names) > 1},
                    height=_HEIGHT,
                )
            self._charts[chart.title] = names, handle


def _series(chart: Chart) -> tuple[Any, ...]:
    measured = [name for name in chart.curves if name not in chart.planned]
    series: list[Any] = [{'label': 's'}]
    for name in chart.curves:
        dashed = name in chart.planned
        number = measured.index(name.partition(',')[0] if dashed else name)
        one = {'label': name, 'stroke': COLOURS[number % len(COLOURS)], 'width': 1.5}
        series.append({**one, 'dash': [6, 4], 'width': 1.0} if dashed else one)
    return tuple(series)


def _text(text: str) -> str:
    return html.escape(text)


def _of_a_browser(act: Callable[[], None]) -> Callable[[Any], None]:
    """Return a callback for changes made in a browser, not for those made by the program."""

    def callback(event: Any) -> None:
        if event.client is not None:
            act()

    return callback
