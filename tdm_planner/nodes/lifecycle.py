# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Managed nodes (https://design.ros2.org/articles/node_lifecycle.html) that can start themselves.

unconfigured   parameters, diagnostics and the services of the lifecycle
inactive       all topics and services are there; nothing but diagnostics is published
active         at work
finalized      as unconfigured, permanently
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleNodeMixin
from rosgraph_msgs.msg import Clock
from tdm_planner.exceptions import Failure, TdmError
from tdm_planner.nodes.diagnostics import Diagnostics, Report
from tdm_planner.nodes.reading import Level
from tdm_planner.nodes.ros_parameters import ParameterNode
from tdm_planner.nodes.services import answer_malformed_requests, answer_reliably
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.problems.planner_parameters import PlannerParameters

AUTOSTART = specifications(PlannerParameters)['autostart']

_SUCCESS = TransitionCallbackReturn.SUCCESS


class ManagedNode(LifecycleNodeMixin, ParameterNode):
    """
    A node with the lifecycle of ROS 2; subclasses say what its transitions do.

    With `autostart` it configures and activates itself, as soon as its parameters, together, allow
    it. Entities created from `configure` on are destroyed with the configuration, and publishers
    are silent unless the node is active.

    Subclasses call `bring_up` at the end of their constructor.
    """

    def __init__(
        self, name: str, title: str, parameters: Mapping[str, ParameterSpec], **options: Any
    ) -> None:
        self._kept: frozenset[int] | None = None  # ids of what stays for as long as the node
        self._configuration = 0
        ParameterNode.__init__(self, name, {AUTOSTART.name: AUTOSTART, **parameters}, **options)
        count = len(list(self.services))
        LifecycleNodeMixin.__init__(self)
        for service in list(self.services)[count:]:
            answer_reliably(self, service)
            answer_malformed_requests(self, service)
        self._stage = 'unconfigured'
        self._setback = ''
        self._start_failed = False
        self._diagnostics = Diagnostics(self, title, self._report_stage)

    # What subclasses say.

    @abstractmethod
    def configure(self) -> None:
        """Create topics and services from the parameters; raises TdmError where that fails."""

    @abstractmethod
    def activate(self) -> None:
        """Begin to work; publishers publish from now on. Raises TdmError where that fails."""

    @abstractmethod
    def deactivate(self) -> None:
        """Leave the plant safe and cease to work; publishers are silent afterwards."""

    @abstractmethod
    def cleanup(self) -> None:
        """Release what `configure` made, if only in part; topics and timers go by themselves."""

    @abstractmethod
    def report(self) -> Report:
        """Return what the diagnostics say of the node at work."""

    # What they may ask.

    @property
    def active(self) -> bool:
        """Whether the node is at work."""
        return self._stage == 'active'

    @property
    def configured(self) -> bool:
        """Whether topics and services are there."""
        return self._stage in ('active', 'inactive')

    def bring_up(self) -> None:
        """Configure and activate, unless a lifecycle manager is to do it."""
        if self._kept is None:
            self._kept = frozenset(id(item) for item, _ in self._entities())
        if not self.parameter_values[AUTOSTART.name]:
            return
        self._start_failed = (
            self.trigger_configure() != _SUCCESS or self.trigger_activate() != _SUCCESS
        )

    def values_changed(self) -> None:
        """Start if invalid parameters had prevented it."""
        if self._start_failed and self._stage == 'unconfigured':
            self.bring_up()

    def destroy_node(self) -> None:
        """Leave the plant safe before the node is gone."""
        if self.active:
            with suppress(Exception):  # of a context that is shut down: nothing can be sent
                self._rest()
        super().destroy_node()

    # What belongs to a configuration.

    def create_publisher(self, *args: Any, **kwargs: Any) -> Any:
        """Create a publisher that publishes only while the node is active."""
        if self._kept is None:
            return super().create_publisher(*args, **kwargs)
        publisher = self.create_lifecycle_publisher(*args, **kwargs)
        if self.active:
            publisher.on_activate(None)
        return publisher

    def create_timer(
        self, timer_period_sec: float, callback: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """Create a timer that ends with the configuration."""
        callback = self._while_configured(callback)
        return super().create_timer(timer_period_sec, callback, *args, **kwargs)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any
    ) -> Any:
        """Create a subscription that ends with the configuration."""
        if msg_type is not Clock:  # which rclpy subscribes, and keeps
            callback = self._while_configured(callback)
        return super().create_subscription(msg_type, topic, callback, *args, **kwargs)

    def _while_configured(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Guard a callback: EventsExecutor may call it after its entity was destroyed."""
        if self._kept is None:
            return callback
        made = self._configuration
        return lambda *message: callback(*message) if made == self._configuration else None

    def _entities(self) -> list[tuple[Any, Callable[[Any], Any]]]:
        """Return everything that the node has, with what destroys it."""
        kinds: tuple[tuple[Iterable[Any], Callable[[Any], Any]], ...] = (
            (self.timers, self.destroy_timer),
            (self.subscriptions, self.destroy_subscription),
            (self.services, self.destroy_service),
            (self.clients, self.destroy_client),
            (self.publishers, self.destroy_lifecycle_publisher),
        )
        return [(item, destroy) for items, destroy in kinds for item in items]

    # Transitions.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From unconfigured to inactive."""
        return self._go('configure', self.configure, 'inactive', undo=self._release)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From inactive to active."""

        def activate() -> None:
            super(ManagedNode, self).on_activate(state)
            self._stage = 'active'
            self.activate()

        return self._go('activate', activate, 'active', undo=self._rest)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From active to inactive."""
        return self._go('deactivate', self._rest, 'inactive')

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From inactive to unconfigured."""
        self._start_failed = False  # a manager has it now
        return self._go('clean up', self._release, 'unconfigured')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From any state to finalized; the process runs until it gets a signal."""
        return self._go('shut down', self._give_up, 'finalized')

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured after an error in a transition."""
        try:
            self._give_up()
        except Exception as error:  # noqa: B902
            self.get_logger().error(f'after the error: {Failure.of(error).sentence}')
            self._enter('finalized')
            return TransitionCallbackReturn.FAILURE
        self._enter('unconfigured')
        return _SUCCESS

    def _go(
        self,
        what: str,
        action: Callable[[], None],
        stage: str,
        undo: Callable[[], None] | None = None,
    ) -> TransitionCallbackReturn:
        """Run a transition; `undo` reverts one that may fail."""
        before = self._stage
        try:
            action()
        except Exception as error:  # noqa: B902
            failure = Failure.of(error)
            self._setback = f'cannot {what}: {failure.sentence}'
            self.get_logger().error('\n'.join(filter(None, [self._setback, failure.trace])))
            if undo is None or not isinstance(error, TdmError):
                return TransitionCallbackReturn.ERROR
            undo()
            self._enter(before)
            return TransitionCallbackReturn.FAILURE
        self._setback = ''
        self._enter(stage)
        return _SUCCESS

    def _enter(self, stage: str) -> None:
        if stage != self._stage or not self._setback:
            self.get_logger().info(stage)
        self._stage = stage
        self._diagnostics.update()

    def _rest(self) -> None:
        try:
            self.deactivate()
        finally:
            self._stage = 'inactive'
            super().on_deactivate(None)

    def _release(self) -> None:
        """Destroy what was created from `configure` on."""
        try:
            self.cleanup()
        finally:
            self._configuration += 1
            for item, destroy in self._entities():
                of_rclpy = getattr(item, 'msg_type', None) is Clock  # made with use_sim_time
                if id(item) not in (self._kept or ()) and not of_rclpy:
                    destroy(item)

    def _give_up(self) -> None:
        if self.active:
            self._rest()
        self._release()

    def _report_stage(self) -> Report:
        if self.active:
            return self.report()
        message = '; '.join(filter(None, [self._stage, self._setback]))
        return Report(Level.ERROR if self._setback else Level.OK, message)
