"""How many requests a tool sends: the API server counts them for a user that only the bench uses.

A FlowSchema of its own gives that user a row in the API server's metrics, and no limit. Requests
for containers' logs are not counted by FlowSchema; no other user sends them meanwhile.
"""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs

NAME = "rigel-bench"
NAMESPACE = "kube-system"
#: The lines of the API server's metrics that count the user's requests.
OWN = (
    re.compile(
        rf'^apiserver_flowcontrol_dispatched_requests_total{{flow_schema="{NAME}".*}} (\S+)$', re.M
    ),
    re.compile(r'^apiserver_request_total{.*resource="pods".*subresource="log".*} (\S+)$', re.M),
)
ACCOUNT = {"kind": "ServiceAccount", "name": NAME, "namespace": NAMESPACE}
EVERYTHING = {"verbs": ["*"], "apiGroups": ["*"], "resources": ["*"]}
OBJECTS = (
    {
        "apiVersion": "v1",
        "kind": "ServiceAccount",
        "metadata": {"name": NAME, "namespace": NAMESPACE},
    },
    {
        "apiVersion": "rbac.authorization.k8s.io/v1",
        "kind": "ClusterRoleBinding",
        "metadata": {"name": NAME},
        "roleRef": {
            "apiGroup": "rbac.authorization.k8s.io",
            "kind": "ClusterRole",
            "name": "cluster-admin",
        },
        "subjects": [ACCOUNT],
    },
    {
        "apiVersion": "flowcontrol.apiserver.k8s.io/v1",
        "kind": "FlowSchema",
        "metadata": {"name": NAME},
        "spec": {
            "matchingPrecedence": 10,
            "priorityLevelConfiguration": {"name": "exempt"},
            "rules": [
                {
                    "subjects": [
                        {
                            "kind": "ServiceAccount",
                            "serviceAccount": {"name": NAME, "namespace": NAMESPACE},
                        }
                    ],
                    "resourceRules": [{**EVERYTHING, "clusterScope": True, "namespaces": ["*"]}],
                    "nonResourceRules": [{"verbs": ["*"], "nonResourceURLs": ["*"]}],
                }
            ],
        },
    },
)


@attrs.frozen
class CountedUser:
    """A user whose requests are counted.

    Attributes:
        kubectl: the command line of another user, who reads the count.
        kubeconfig: the user's; its context is named as that of `kubectl`.
    """

    kubectl: Sequence[str]
    kubeconfig: Path

    def count(self) -> int:
        """Return how many requests the user has sent so far."""
        metrics = call(self.kubectl, "get", "--raw", "/metrics")
        return count_in(metrics)


def count_in(metrics: str) -> int:
    """Return the number of the user's requests in the API server's metrics."""
    return sum(int(float(number)) for line in OWN for number in line.findall(metrics))


@contextlib.contextmanager
def counted_user(kubectl: Sequence[str], directory: Path) -> Iterator[CountedUser]:
    """Make the user, and a kubeconfig in a directory; remove the user at the end."""
    objects = json.dumps({"apiVersion": "v1", "kind": "List", "items": OBJECTS})
    call(kubectl, "apply", "-f", "-", text=objects)
    try:
        token = call(kubectl, "create", "token", NAME, "-n", NAMESPACE, "--duration=24h").strip()
        config = json.loads(call(kubectl, "config", "view", "--minify", "--flatten", "-o", "json"))
        config["users"][0]["user"] = {"token": token}
        kubeconfig = directory / "counted.kubeconfig"
        kubeconfig.touch(mode=0o600)
        kubeconfig.write_text(json.dumps(config))
        yield CountedUser(kubectl, kubeconfig)
    finally:
        call(kubectl, "delete", "-f", "-", text=objects)


def call(kubectl: Sequence[str], *words: str, text: str | None = None) -> str:
    """Run kubectl and return what it prints."""
    done = subprocess.run(
        [*kubectl, *words], check=True, capture_output=True, text=True, input=text
    )
    return done.stdout
