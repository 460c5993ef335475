# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Parts of nodes over DDS: diagnostics, what is known of a tracker, answers of services."""

from collections.abc import Callable
import threading
from types import SimpleNamespace
import warnings

from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock
from rclpy.executors import SingleThreadedExecutor
from rclpy.service import Service
from std_srvs.srv import Trigger
from stepped_ros import Stepped
from tdm_planner.exceptions import Busy, Failure
from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.diagnostics import Diagnostics, Report
from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.planning import PlanQueue
from tdm_planner.nodes.reading import Level
from tdm_planner.nodes.runtime import make_executor
from tdm_planner.nodes.services import ATTEMPTS, create_plan_service, Request
from tdm_planner.nodes.tracker_plans import goal_status, TrackerWatch
from tdm_planner.tracking.motion import ObservedPhase
from tdm_planner.tracking.pendulum_tracking import PendulumTrackerParameters

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)


def test_diagnostics_are_published_every_second_and_on_change(ros):
    for level in Level:
        assert bytes([level]) == getattr(DiagnosticStatus, level.name)
    reports = [Report(Level.OK, 'fine', {'figure': 1 / 3, 'count': 2})]
    received = ros.subscribe('/diagnostics')
    diagnostics = Diagnostics(ros.node, 'something', lambda: reports[-1])
    ros.spin_for(1.1)
    (array,) = received
    (status,) = array.status
    assert (status.level, status.name, status.message) == (b'\x00', '/test: something', 'fine')
    assert [(i.key, i.value) for i in status.values] == [('figure', '0.333333'), ('count', '2')]
    assert array.header.stamp.sec > 0
    diagnostics.update()
    ros.spin_for(0.1)
    assert len(received) == 1
    for report in (Report(Level.ERROR, 'fine'), Report(Level.ERROR, 'broken')):
        reports.append(report)
        diagnostics.update()
        ros.settle()
    assert [array.status[0].message for array in received] == ['fine', 'fine', 'broken']
    ros.spin_for(2.0)
    assert len(received) == 5


# What is known of the plan at 7.
TOLD: list[tuple[dict[int, int], ObservedPhase, int | None, bool]] = [
    ({5: EXECUTING}, ObservedPhase.FOLLOWING, 5, False),
    ({5: SUCCEEDED}, ObservedPhase.FOLLOWING, 5, False),
    ({5: ACCEPTED}, ObservedPhase.FOLLOWING, 5, False),  # its start has come meanwhile
    ({7: ACCEPTED}, ObservedPhase.FOLLOWING, 7, False),
    ({9: ACCEPTED}, ObservedPhase.IDLE, None, False),
    ({5: EXECUTING, 6: ACCEPTED}, ObservedPhase.FOLLOWING, 6, False),
    ({5: EXECUTING, 6: ABORTED}, ObservedPhase.FOLLOWING, 5, False),
    ({5: CANCELING, 9: ACCEPTED}, ObservedPhase.RECOVERING, None, False),
    ({5: ABORTED}, ObservedPhase.IDLE, None, False),
    ({5: CANCELED}, ObservedPhase.IDLE, None, True),
    ({}, ObservedPhase.IDLE, None, True),
]


def test_the_mode_is_what_the_tracker_tells(ros):
    """By the status of plans, by their starts; where the clock is set a plan goes on."""
    clock = SimpleNamespace(step=0)  # of a time of day that may be set; instants in ns
    clock.instant = lambda stamp: float(stamp - clock.step)
    watch = TrackerWatch(ros.node, clock, 'told/', PendulumTrackerParameters)
    publisher = ros.publisher('told/tracker_status')

    def tell(statuses: dict[int, int]) -> None:
        plans = [goal_status(start, status) for start, status in statuses.items()]
        publisher.publish(GoalStatusArray(status_list=plans))
        ros.settle()

    # Where no tracker was heard, the plan is taken to be followed.
    assert watch.phase(7) is ObservedPhase.FOLLOWING
    assert (watch.followed(7), watch.inactive) == (None, False)
    assert not watch.rejects(5)
    for statuses, *expected in TOLD:
        tell(statuses)
        assert [watch.phase(7), watch.followed(7), watch.inactive] == expected, statuses
        for start, status in statuses.items():
            assert watch.rejects(start) == (status in (ABORTED, CANCELED, CANCELING))
        assert watch.rejects(1234)
    tell({5: EXECUTING})
    clock.step = 100
    assert watch.followed(7) == 5
    tell({5: SUCCEEDED, 109: ACCEPTED})
    assert (watch.followed(7), watch.followed(9)) == (5, 9)
    watch.forget_plans()
    assert watch.followed(9) is None


def test_the_parameters_are_those_that_the_tracker_has_at_present(ros):
    watch = TrackerWatch(ros.node, MotionClock(ros.node), 'tuned/', PendulumTrackerParameters)

    def knows(weight: float) -> bool:
        return watch.parameters is not None and watch.parameters.weights.theta == weight

    assert not watch.inactive  # nobody is there: another controller may follow
    tracker = ros.start('tracker', {'autostart': False}, 'tuned')
    assert ros.meet(lambda: watch.inactive)
    for weight in (5.0, 9.0):
        tracker.end_cleanly()
        given = {'limits.torque': 0.02, 'weights.theta': weight}
        tracker = ros.start('tracker', given, 'tuned')
        assert ros.spin_until(lambda weight=weight: knows(weight), 5.0)
    assert watch.parameters.limits.torque == 0.02
    assert ros.set_parameters('/tuned/tracker', weights__theta=7.0) == ['']
    assert ros.spin_until(lambda: knows(7.0), 1.0)
    tracker.end_cleanly()
    assert ros.meet(lambda: watch.inactive)


def test_of_requests_that_are_never_answered_the_last_is_kept(ros):
    """As by a process that hangs: of the tracker, and of the planner."""
    watch = TrackerWatch(ros.node, MotionClock(ros.node), 'hung/', PendulumTrackerParameters)
    hung = ros.node.create_service(GetParameters, 'hung/tracker/get_parameters', lambda *_: None)
    hung.send_response = lambda *_: None
    ros.publisher('hung/tracker_status').publish(GoalStatusArray())
    tracker = ros.start('tracker', {}, 'asks').node
    asked = list[Request]()
    create_plan_service(ros.node, Trigger, 'asks/plan', lambda request, _: asked.append(request))
    assert ros.meet(tracker._planner.service_is_ready)
    for _ in range(3):
        tracker._ask_for_plan()
        ros.spin_for(10.1)
    assert len(asked) == 3
    for client in (watch._client, tracker._planner):
        assert len(client._pending_requests) == 1


DEACTIVATE = Transition(id=Transition.TRANSITION_DEACTIVATE)
REQUESTS = {
    **dict.fromkeys(('think', 'at_once'), (Trigger, {})),
    'stranger/get_state': (GetState, {}),
    'stranger/change_state': (ChangeState, {'transition': DEACTIVATE}),
    'stranger/get_parameters': (GetParameters, {'names': ['autostart']}),
}


class Stranger(ManagedNode):
    """A node that only serves; for `think` its queue waits for `release`."""

    def __init__(self, **options) -> None:
        super().__init__('stranger', 'stranger', {}, **options)
        self.queue, self.release = PlanQueue(self), threading.Event()
        self.create_service(Trigger, 'at_once', lambda _, response: response)
        create_plan_service(self, Trigger, 'think', self.on_request)
        self.bring_up()

    def configure(self) -> None:
        pass

    activate = deactivate = cleanup = configure

    def report(self) -> Report:
        return Report(Level.OK, 'active')

    def on_request(self, request: Request, _) -> None:
        def done(thought: bool) -> None:
            assert threading.current_thread() is threading.main_thread()
            request.answer('thought' if thought else '')

        try:
            self.queue.request(lambda: self.release.wait(20.0), done)
        except Busy as error:
            request.answer(Failure.of(error))


class Server:
    """Serves a `Stranger` by the executor that `make` makes, and the test's own node."""

    def __init__(self, ros: Stepped, make: Callable) -> None:
        self.ros, self.node = ros, Stranger(context=ros._context)
        self.executor = make(context=ros._context)
        self.executor.add_node(self.node)

    def serve_until(self, condition: Callable[[], bool], rounds: int = 2000) -> bool:
        while rounds and not condition():
            rounds -= 1
            self.executor.spin_once(timeout_sec=0.01)
            while self.ros._serve():
                pass
        return condition()


@pytest.fixture
def middleware(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Let the middleware give up the first `lost` answers to whoever asks."""
    made, really_send = SimpleNamespace(lost=0, attempts=0), Service.send_response
    told = 'failed to send response (timeout): client will not receive response'

    def send(*of) -> None:
        made.attempts += 1
        if made.attempts > made.lost:
            really_send(*of)
        else:
            warnings.warn(told, RuntimeWarning, stacklevel=1)

    monkeypatch.setattr(Service, 'send_response', send)
    monkeypatch.setattr('tdm_planner.nodes.services.RETRY', 0.01)
    monkeypatch.setattr('tdm_planner.nodes.clocks.Clock', Clock)  # one that runs
    return made


@pytest.fixture
def server(ros: Stepped, make, middleware):
    made = Server(ros, make)
    yield made
    made.node.release.set()
    made.executor.shutdown()
    made.node.destroy_node()


@pytest.mark.parametrize(
    ('service', 'lost'), [*((service, 2) for service in REQUESTS), ('at_once', 1000)]
)
@pytest.mark.parametrize('make', [make_executor, SingleThreadedExecutor])
def test_an_answer_that_the_middleware_drops_is_sent_again(ros, server, middleware, service, lost):
    """As when a service does not know its client yet."""
    server.node.release.set()
    middleware.lost = lost
    kind, content = REQUESTS[service]
    answer = ros.request(service, kind, kind.Request(**content))
    attempts, arrives = min(lost + 1, ATTEMPTS), lost < ATTEMPTS
    assert server.serve_until(lambda: middleware.attempts == attempts)
    assert server.serve_until(answer.done, 2000 if arrives else 10) == arrives
    assert middleware.attempts == attempts


@pytest.mark.parametrize('make', [SingleThreadedExecutor])
def test_every_request_of_a_burst_is_answered(ros, server):
    """As when many clients ask while the node is held up: none may be left waiting for ever."""
    client = ros.node.create_client(Trigger, 'think', qos_profile=SERVICE)
    assert ros.meet(client.service_is_ready)
    asked = [client.call_async(Trigger.Request()) for _ in range(60)]
    ros.settle()  # all requests arrive before the server looks at the first
    assert server.serve_until(lambda: sum(future.done() for future in asked) == 59)
    server.node.release.set()
    assert server.serve_until(lambda: all(future.done() for future in asked))
    told = sorted({future.result().message for future in asked})
    assert [text[:15] for text in told] == ['thought', '{"code": "BUSY"']
