"""Whatever stands in what a release keeps about itself, a reader reads it or says which it is.

Labels, annotations, Leases and ConfigMaps: anyone with rights in the namespace may change them. A
Secret's content is in test_damaged.py.
"""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import datetime, timezone
from functools import cache
from typing import Any

from rigel_graph.discovery.members import members
from rigel_graph.pods import expected_nodes, find_leaving, place_nodes, read_pods
from rigel_k8s.cli.listing import summary_table
from rigel_k8s.cli.status import status_text
from rigel_k8s.cli.tables import age
from rigel_k8s.commands.pods import find_matching, pod_of
from rigel_k8s.commands.status import Status
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.podnodes import NODES_ANNOTATION, split_all
from rigel_k8s.release.difference import compare_objects
from rigel_k8s.release.history import History
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.locking import PROCESS, describe, is_alive, lease_ref, manifest, process
from rigel_k8s.release.revisions import records
from rigel_k8s.release.rollback import find_unfinished
from rigel_k8s.release.status import status
from rigel_k8s.release.types import Desired
from rigel_ui.nodes import node_entry
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Store
from tests.support.manifests import RELEASE, claim, config, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, diff, down, rollback

NOW = datetime(2026, 11, 24, tzinfo=timezone.utc)
KINDS = ("Secret", "Lease", "Deployment", "Pod", "ConfigMap", "ReplicaSet")
NETWORK, STATUS = "rigel-k8s/network", "k8s.v1.cni.cncf.io/network-status"
BOOT, SPACE, PID, START = process().split()
DEEP = "[" * 5000
#: What any text may be instead.
ODD = (
    *("", " ", "x", "0", "1", "-1", "7", "1.5", "1e400", "٣", "99999999999999999999", "true", "\n"),
    *("null", "[]", "{}", "[1]", "[[]]", "[null]", '"x"', "{", '{"": {}}', '{"a": null}', DEEP),
    *("2026-13-99T99:99:99Z", "2026-01-01T00:00:00Z", "9999-12-31T23:59:59.999999Z", "é" * 300),
    *("good", "pending", "interrupted", "failed", "superseded", "demo", "other", "a b c d"),
)
#: What some texts may be as well, since they have a form.
FORMS = {
    NETWORK: (
        *('{"ros": []}', '{"ros": "3", "mode": 1}', '{"mode": [], "address": {}}', '{"mode": {}}'),
        *('{"mode": "peers", "domain": "x", "ros": "2"}', '{"mode": "peers", "domain": []}'),
        *('{"mode": "peers", "ros": "2", "interface": 1}', '{"mode": "host", "shared_memory": 1}'),
    ),
    STATUS: (
        *('[{"interface": "net1", "ips": 5}]', '[{"interface": "net1", "ips": [null]}]'),
        *('[{"interface": [], "ips": {}}]', '[1, {"ips": ["10.0.0.1"]}]', '{"ips": []}'),
    ),
    NODES_ANNOTATION: (
        *('{"node": 1}', '{"node": {"rigel-k8s/ros-name": 5}}', '{"node": [], "x": "y"}'),
        *('{"other": {}}', '{"node": {}, "two": null}', '{"": {"": ""}}'),
    ),
    PROCESS: (
        *(f"{BOOT} {SPACE} x {START}", f"{BOOT} {SPACE} ² 1", f"{BOOT} {SPACE} {'9' * 300} 1"),
        *(f"{BOOT} {SPACE} {PID} {START}", f"{BOOT} {SPACE} -1 1", f"{BOOT} {SPACE}"),
    ),
}


def make_node(name: str, *others: str, image: str = "app:1") -> dict[str, Any]:
    """Return a workload of one node, or of several in one pod."""
    made = workload(name, image)
    pod = made["spec"]["template"]
    note = {"mode": "peers", "ros": "2", "domain": 1, "interface": "net1", "address": "10.1.0.9/24"}
    networks = [{"name": "n/x", "interface": "net1", "ips": ["10.1.0.9"]}]
    notes = {
        NETWORK: json.dumps(note),
        STATUS: json.dumps(networks),
        ROS_NAME_ANNOTATION: f"/{name}",
    }
    [container] = pod["spec"]["containers"]
    container["volumeMounts"] = [{"name": "s", "mountPath": "/rigel-k8s"}]
    if others:
        container["name"] = others[0]
        pod["spec"]["containers"] += [{**container, "name": one} for one in others[1:]]
        notes[NODES_ANNOTATION] = json.dumps({one: {ROS_NAME_ANNOTATION: one} for one in others})
    pod["metadata"]["annotations"] = notes
    made["metadata"]["annotations"] = dict(notes)
    return made


@cache
def prepare() -> Store:
    """Return a cluster with a release that has a history, and a Lease that was left."""
    fake = FakeCluster(Store(controllers=Controllers()))
    fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    for image in ("app:1", "app:2"):
        objects = (
            make_node("talker", image=image),
            make_node("pod", "node", "two"),
            config("c", a="1"),
        )
        options = {"nodes": {"talker": {"image": image}}}
        deploy(Desired(RELEASE, (*objects, claim()), options=options), fake, report=Recorder())
    rollback(fake, RELEASE, report=Recorder())
    fake.settle(10)
    lease = manifest(lease_ref(RELEASE))
    lease["metadata"]["annotations"] = {PROCESS: f"{BOOT} {SPACE} {PID} 0"}
    fake.create(lease)
    return fake.store


def damage(fake: FakeCluster, chance: random.Random) -> None:
    """Change one to three texts of some objects."""
    for _ in range(chance.randint(1, 3)):
        kind = chance.choice(KINDS)
        live = chance.choice([live for ref, live in fake.objects.items() if ref.kind == kind])
        found = chance.choice([texts for texts in list_texts(live) if texts] or [{"": ""}])
        key = chance.choice(sorted(found))
        if chance.random() < 0.2:
            del found[key]
        else:
            own = FORMS.get(key, ())
            found[key] = chance.choice(own if own and chance.random() < 0.7 else ODD)
        if chance.random() < 0.05:
            live["metadata"].pop(chance.choice(("labels", "annotations")), None)
        if kind == "Lease" and chance.random() < 0.05:
            live["spec"] = {}


def list_texts(live: dict[str, Any]) -> Iterator[dict[str, str]]:
    """Yield the texts by name that anyone may change."""
    template = live.get("spec", {}).get("template", {}).get("metadata", {})
    for meta in (live["metadata"], template):
        for part in ("labels", "annotations"):
            yield meta.setdefault(part, {}) if meta else {}
    yield live.get("data", {}) if live["kind"] == "ConfigMap" else {}
    if live["kind"] == "Lease":
        yield live["spec"]


def list_uses(fake: FakeCluster, chance: random.Random) -> Iterator[Callable[[], object]]:
    """Yield what reads a release; now and then what changes it as well."""

    def show_history() -> None:
        known = records(fake, RELEASE)
        for entry in History(ROS_NAME_ANNOTATION).make_entries(known):
            age(entry.created, NOW)
        first, last = known[0].revision(), known[-1].revision()
        compare_objects(first.objects, last.objects, ("a", "b"))

    def show_graph() -> None:
        items = [live for ref, live in fake.objects.items() if ref.kind == "Pod"]
        deployments = fake.list("apps/v1", "Deployment", "n", labels={"rigel-k8s/release": "demo"})
        found = read_pods(items)
        place_nodes([], found, expected_nodes(deployments))
        find_leaving(items)
        members(items)
        pods = [pod_of(item) for item in split_all(items)]
        find_matching(sorted(pods, key=lambda pod: (pod.workload, pod.created)), "talker")

    def show_status() -> None:
        found = status(fake, RELEASE)
        status_text(Status(found), NOW)
        for one in found.workloads:
            node_entry(one, [])

    yield show_status
    yield lambda: summary_table(list_releases(fake, None), NOW, everywhere=True)
    yield show_history
    yield show_graph
    yield lambda: describe(lease_ref(RELEASE), fake.objects[lease_ref(RELEASE)])
    yield lambda: is_alive(fake.objects[lease_ref(RELEASE)])
    if chance.random() < 0.1:
        objects = make_node("talker", image="app:3"), make_node("pod", "node"), config("c", a="2")
        wanted = Desired(RELEASE, objects)
        yield lambda: diff(wanted, fake)
        yield lambda: find_unfinished(fake, RELEASE, records(fake, RELEASE))  # type: ignore[arg-type]
        for ref in [ref for ref in fake.objects if ref.kind == "Pod"]:
            del fake.objects[ref]  # nothing ends them here
        yield lambda: down(fake, RELEASE, volumes=True, report=Recorder(), lock_timeout=0.0)


def try_one(seed: int) -> None:
    """Read a damaged release."""
    chance = random.Random(seed)
    fake = FakeCluster(prepare().clone())
    fake.store.controllers = None  # they need their own notes
    damage(fake, chance)
    for use in list_uses(fake, chance):
        with suppress(RigelK8sError):
            use()


def test_anything_is_read_or_refused() -> None:
    """Hundreds of random changes, or RIGEL_TEST_CASES: no other exception than ours."""
    for seed in range(int(os.environ.get("RIGEL_TEST_CASES", "600"))):
        try_one(seed)
