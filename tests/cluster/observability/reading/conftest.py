"""An application whose nodes say things at all levels, and users with few rights."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import attrs
import pytest

from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.refs import ObjectRef
from tests.support import until as waiting

from ...background import Background
from ...rights import wait_for_right

T = TypeVar("T")
Done = subprocess.CompletedProcess[str]

#: Counts, so that a line that is missing or there twice shows.
TALKER = """
import rospy, std_msgs.msg, traceback
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=1)
rate = rospy.Rate(5)
number = 0
while not rospy.is_shutdown():
    number += 1
    publisher.publish("hello %d" % number)
    rospy.loginfo("said %d", number)
    if number % 10 == 0:
        rospy.logwarn("late %d", number)
    if number % 20 == 0:
        try:
            [][number]
        except IndexError:
            rospy.logerr("failed %d\\n%s", number, traceback.format_exc())
    rate.sleep()
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda s: rospy.loginfo("heard " + s.data))
rospy.spin()
"""
#: More lines than Loki gives in one answer.
SHOUTER = """
import rospy, time
rospy.init_node("shouter")
for number in range(12000):
    print("flood", number, flush=True)
time.sleep(1000)
"""
#: What users with few rights may do in the application's namespace.
READ = {"apiGroups": [""], "resources": ["pods", "pods/log"], "verbs": ["get", "list", "watch"]}


def until(
    look: Callable[[], T],
    what: str,
    patience: float = 180,
    despite: tuple[type[Exception], ...] = (),
) -> T:
    """Return what a look gives as soon as it is anything."""
    return waiting.until(look, what, patience, every=0.5, despite=despite)


@attrs.frozen
class App:
    """A Rigelfile, and the command line beside it."""

    file: Path
    context: str
    namespace: str
    env: dict[str, str] = attrs.field(factory=dict)

    def command(self, *words: str) -> list[str]:
        """Return the command line's words, cluster and namespace before the command."""
        place = ["-f", str(self.file), "--context", self.context, "-n", self.namespace]
        return [sys.executable, "-m", "rigel_k8s", *place, *words]

    def __call__(self, *words: str, code: int = 0) -> Done:
        """Run a command that ends with this exit code."""
        done = subprocess.run(
            self.command(*words),
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
            env={**os.environ, **self.env},
        )
        assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    def lines(self, *words: str) -> list[dict[str, Any]]:
        """Return what `logs -o json` prints."""
        done = self("logs", "-o", "json", *words)
        return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture
def start() -> Iterator[Callable[..., Background]]:
    """Start commands that go on; all are interrupted in the end."""
    started: list[Background] = []

    def call(command: Sequence[str]) -> Background:
        started.append(Background(command))
        return started[-1]

    yield call
    for one in started:
        one.interrupt()


@pytest.fixture(scope="session")
def app(
    context: str,
    cluster: Any,
    base_image: str,
    stack: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[App]:
    """A talker, a listener and a shouter, watched by the stack, deployed once."""
    del stack  # it is there
    name = f"t-reading-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    programs = {"talker": TALKER, "lab/listener": LISTENER, "shouter": SHOUTER}
    options = {
        "ros_master_image": base_image,
        "image": base_image,
        "nodes": {key: {"args": ["python3", "-c", text]} for key, text in programs.items()},
        "observability": {
            "enabled": True,
            "grafana": {"enabled": False},
            "node_exporter": True,
            "ros_metrics": {"topics": ["/chatter"]},
        },
    }
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}}
    made = App(tmp_path_factory.mktemp("reading") / "Rigelfile", context, name)
    made.file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
    made("run", "job", "deploy", "--timeout", "8m")
    yield made
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture
def limited(app: App, cluster: Any, context: str, tmp_path: Path) -> Iterator[Callable[..., App]]:
    """Be a user who may read one namespace, and what else is given: limited([rule, ...])."""
    made: list[ObjectRef] = []

    def call(rules: Sequence[dict[str, Any]] = ()) -> App:
        name = f"limited-{uuid.uuid4().hex[:6]}"
        for manifest in account(name, app.namespace, rules):
            cluster.create(manifest)
            meta = manifest["metadata"]
            ref = (manifest["apiVersion"], manifest["kind"], meta.get("namespace", ""), name)
            made.append(ObjectRef(*ref))
        user = f"system:serviceaccount:{app.namespace}:{name}"
        wait_for_right(cluster, user, READ, app.namespace)
        for rule in rules:
            wait_for_right(cluster, user, rule)
        config = tmp_path / f"{name}.json"
        config.write_text(json.dumps(kubeconfig(cluster, context, app.namespace, name)))
        return attrs.evolve(app, context="limited", env={"KUBECONFIG": str(config)})

    yield call
    for ref in made:
        cluster.delete(ref)


def account(name: str, namespace: str, rules: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a service account that may read pods and their logs, and what the rules say."""
    meta = {"name": name, "namespace": namespace}
    subjects = [{"kind": "ServiceAccount", **meta}]
    api = "rbac.authorization.k8s.io"
    yield {"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta}
    for kind, place, own in (("Role", meta, [READ]), ("ClusterRole", {"name": name}, list(rules))):
        to = {"apiGroup": api, "kind": kind, "name": name}
        yield {"apiVersion": f"{api}/v1", "kind": kind, "metadata": place, "rules": own}
        yield {
            "apiVersion": f"{api}/v1",
            "kind": f"{kind}Binding",
            "metadata": place,
            "roleRef": to,
            "subjects": subjects,
        }


def kubeconfig(cluster: Any, context: str, namespace: str, name: str) -> dict[str, Any]:
    """Return a kubeconfig with which a service account speaks to the cluster."""
    from rigel_k8s.kube.kubeconfig import load

    target = load(None, context)
    ref = ObjectRef("v1", "ServiceAccount", namespace, name)
    url = cluster.client.path_of(ref, "test", subresource="token")
    body = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {}}
    token = cluster.client.call("POST", url, "test", read_mapping, body=body)["status"]["token"]
    authority = base64.b64encode(target.authority.encode()).decode()
    place = {"server": target.server, "certificate-authority-data": authority}
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "c", "cluster": place}],
        "users": [{"name": "u", "user": {"token": token}}],
        "contexts": [{"name": "limited", "context": {"cluster": "c", "user": "u"}}],
    }
