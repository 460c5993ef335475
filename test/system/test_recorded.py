# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The recorder as a process: what comes over the wire is in the bag, what was lost is counted."""

import itertools
import os
from pathlib import Path
import re
import signal

from bag_contents import metadata, read_with_mcap
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes.messages import LATCHED
from tdm_sim.recorder import RECORDING

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def start(ros: Ros, output: Path, *arguments: str) -> NodeProcess:
    process = ros.run('tdm_planner.cli', ['record', '-o', str(output), *arguments])
    assert ros.spin_until(output.is_dir), process.output
    return process


def test_every_message_is_in_the_bag(ros, tmp_path):
    bag = tmp_path / 'bag'
    names = [f'/told/{name}' for name in ('latched', 'states', 'late', 'hasty')]
    latched = ros.node.create_publisher(String, names[0], LATCHED)
    latched.publish(String(data='published before the recorder came'))
    recorder = start(ros, bag)
    states = ros.publisher(names[1], JointState, 300)
    for k in range(300):
        states.publish(JointState(name=['disk'], position=[0.5 * k], effort=[-1.0 * k]))
    late = ros.publisher(names[2], String)
    late.publish(String(data='a late topic'))
    hasty = ros.publisher(names[3], String, BEST_EFFORT)
    assert states.wait_for_all_acked()
    assert late.wait_for_all_acked()
    kept = lambda: b'best effort' in (bag / 'bag.mcap').read_bytes()  # noqa: E731
    assert ros.publish_until(lambda: hasty.publish(String(data='best effort')), kept, every=0.1)
    assert recorder.end(signal.SIGTERM) == 0, recorder.output
    assert 'Traceback' not in recorder.output
    messages = read_with_mcap(bag)
    told = [(state.position[0], state.effort[0]) for state in messages[names[1]]]
    assert told == [(0.5 * k, -1.0 * k) for k in range(300)]
    assert [m.data for m in messages[names[0]]] == ['published before the recorder came']
    assert [m.data for m in messages[names[2]]] == ['a late topic']
    assert {m.data for m in messages[names[3]]} == {'best effort'}
    document = metadata(bag)  # what rosbag2's own file says is what the wire says
    counted = document['topics_with_message_count']
    topics = {item['topic_metadata']['name']: item for item in counted}
    assert document['message_count'] == sum(item['message_count'] for item in counted)
    for name in names:
        assert topics[name]['message_count'] == len(messages[name])
        about = topics[name]['topic_metadata']
        (endpoint,) = ros.node.get_publishers_info_by_topic(name)
        assert about['type'] == endpoint.topic_type
        assert about['type_description_hash'] == str(endpoint.topic_type_hash)
        (offered,) = about['offered_qos_profiles']
        for policy in ('reliability', 'durability'):
            assert offered[policy] == getattr(endpoint.qos_profile, policy).name.lower()


def test_messages_that_were_lost_on_the_way_are_counted(ros, tmp_path):
    bag = tmp_path / 'bag'
    publisher = ros.node.create_publisher(String, '/lost', BEST_EFFORT)
    recorder = start(ros, bag, '/lost')
    assert ros.spin_until(lambda: publisher.get_subscription_count() > 0)
    assert RECORDING not in recorder.output  # no message is written yet
    sent, file = itertools.count(1000), bag / 'bag.mcap'

    def heard(word: str) -> bool:  # a reader counts only what is missing after a first message
        say = lambda: publisher.publish(String(data=word)) or next(sent)  # noqa: E731
        return ros.publish_until(say, lambda: word.encode() in file.read_bytes(), every=0.05)

    assert heard('before the flood')
    os.kill(recorder.process.pid, signal.SIGSTOP)
    for _ in range(1000):
        publisher.publish(String(data='x' * 60_000))
    os.kill(recorder.process.pid, signal.SIGCONT)
    assert heard('after the flood')
    assert recorder.end() == 0
    assert RECORDING in recorder.output
    received = len(read_with_mcap(bag)['/lost'])
    lost = re.search(r'written to .*, (\d+) dropped', recorder.output)
    assert lost is not None, recorder.output
    assert 0 < int(lost.group(1)) <= next(sent) - received
