# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Goal tools of RViz and Foxglove: a pose moves a robot's place in the formation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import textwrap

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from tdm_planner.exceptions import Failure, InvalidProblem
from tdm_planner.nodes.markers import Pen
from tdm_planner.nodes.planned_plants import Values
from tdm_planner.nodes.reading import check_frame, yaw_of
from tdm_planner.nodes.services import Request
from tdm_planner.plant_kind import ARENA_FRAME, ROBOT
from tdm_planner.problems.formation.parameters import place_in_arena, place_in_formation
from visualization_msgs.msg import Marker, MarkerArray

NOTICE_TIME = 8.0  # s that the notice of a rejected goal stays visible

_QUEUE = 10
_LETTERS = 0.1  # m
_LINE = 44  # letters


def arena_pose(message: PoseStamped) -> tuple[float, float, float]:
    """
    Return x, y [m] and yaw [rad] of a pose in the arena; its height does not matter.

    Raises
    ------
    InvalidProblem
        If the frame is another, a value is not finite, or the quaternion not of unit length.

    """
    check_frame(ROBOT, message, 'goal_pose')
    x, y = message.pose.position.x, message.pose.position.y
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InvalidProblem(f"the pose's position is ({x:g}, {y:g}) m: must be finite numbers")
    return x, y, yaw_of(message.pose.orientation)


class GoalTool:
    """
    Takes poses for one robot on `<robot>/goal_pose`, and asks for a plan with its place moved.

    The place is the parameter `formation.<robot>`, which is set if there is a plan. Otherwise
    parameter and plan stay, and the reason is logged and shown at the pose by `show` for some
    seconds.
    """

    def __init__(
        self,
        node: Node,
        robot: str,
        values: Callable[[], Values],
        request: Callable[[Request], None],
        show: Callable[[MarkerArray], None],
    ) -> None:
        self._node, self._robot = node, robot
        self._values, self._request, self._show = values, request, show
        self._subscription = node.create_subscription(
            PoseStamped, f'{robot}/goal_pose', self._on_pose, _QUEUE
        )

    def _on_pose(self, message: PoseStamped) -> None:
        robot, values = self._robot, self._values()
        title = f"goal_pose of '{robot}' rejected"
        parameter, anchor = f'formation.{robot}', values['formation.anchor']
        try:
            pose = arena_pose(message)
        except InvalidProblem as error:
            failure = Failure.of(error)
            self._node.get_logger().warning(f'{title}: {failure}')
            place = values.get(parameter) or (0.0, 0.0, 0.0)
            self._tell(place_in_arena(anchor, place), failure)
            return
        changes = {parameter: place_in_formation(anchor, pose)}
        self._request(Request(lambda outcome: self._tell(pose, outcome), changes, True, title))

    def _tell(self, pose: Sequence[float], outcome: str | Failure) -> None:
        """Show why there is no plan, or remove the text shown before."""
        pen = Pen(ARENA_FRAME, lifetime=NOTICE_TIME)
        if isinstance(outcome, Failure):
            text = textwrap.fill(f'{self._robot}: {outcome.code}: {outcome.reason}', _LINE)
            marker = pen.text('rejected', text, (pose[0], pose[1], 0.3), _LETTERS)
        else:
            marker = pen.marker('rejected', action=Marker.DELETE)
        self._show(MarkerArray(markers=[marker]))
