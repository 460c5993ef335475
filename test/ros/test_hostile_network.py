# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Six nodes and a network that means them harm: what they are allowed, survive, and write."""

import os
from xml.etree import ElementTree

from node_fuzzing import NODES, SixNodes
from ros_harness import SOURCE
from tools.security_policy import OPERATOR, Rights

POLICY = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml').getroot()


def granted(path: str) -> Rights:
    (context,) = POLICY.findall(f"contexts/context[@path='{path}']")
    rights = (('topics', 'publish'), ('topics', 'subscribe'), ('services', 'reply'),
              ('services', 'request'))  # fmt: skip
    found = (context.iterfind(f".//{group}[@{right}='ALLOW']/*") for group, right in rights)
    return Rights(*(frozenset(item.text for item in items if item.text) for items in found))


def test_nodes_use_what_the_policy_allows_and_survive_whatever_comes(ros, tmp_path, monkeypatch):
    """They use all of it and nothing else, and write nothing but logs."""
    nodes = SixNodes(ros)

    def used(path: str) -> Rights:
        namespace, _, name = path.rpartition('/')
        kinds = 'publisher', 'subscriber', 'service', 'client'
        asks = (getattr(ros.node, f'get_{kind}_names_and_types_by_node') for kind in kinds)
        found = (dict(ask(name, namespace)) for ask in asks)
        return Rights(*(frozenset(items) - {'/clock'} for items in found))

    def all_there() -> bool:
        names = {f'{ns}/{name}' for name, ns in ros.node.get_node_names_and_namespaces()}
        return set(NODES) <= names and all(used(path) == granted(path) for path in NODES)

    ros.meet(all_there)
    assert {path: used(path) for path in NODES} == {path: granted(path) for path in NODES}
    for context in POLICY.iterfind('contexts/context'):  # torques come from the plant's tracker
        path = context.attrib['path']
        for topic in granted(path).publishes:
            if topic.endswith('/joint_command'):
                assert path == topic.replace('joint_command', 'tracker')
    operator = granted(OPERATOR)
    published = {name.rsplit('/', 1)[-1] for name in operator.publishes}
    assert published == {'goal_pose', 'rosout', 'parameter_events'}
    assert {'/pendulum/plan', '/robots/plan'} <= operator.calls
    assert not operator.serves
    monkeypatch.chdir(tmp_path)
    for name in ('HOME', 'TMPDIR', 'XDG_CACHE_HOME', 'XDG_CONFIG_HOME'):
        monkeypatch.setenv(name, str(tmp_path))
    nodes.refuse_types_that_do_not_exist()
    nodes.endure(30)
    assert not os.listdir(tmp_path)
