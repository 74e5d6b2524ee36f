"""The agent as objects of Kubernetes: a Deployment with a Role for its namespace; pure."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

from rigel_k8s import __version__
from rigel_k8s.objects.pods import drop_empty
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.workloads import ReleaseContext, config_map, deployment
from rigel_muto.agent.options import MutoAgent

#: What `rigel image muto-agent` builds.
AGENT_IMAGE = f"ghcr.io/rigel-k8s/muto-agent:{__version__}"
#: Where the pod has its Rigelfile, and the files for the broker. The Rigelfile is mounted alone,
#: since all users may write into the directory of a ConfigMap: no such directory is trusted.
DIRECTORY, CREDENTIALS = "/etc/rigel-k8s", "/etc/rigel-k8s-broker"
FILE = "Rigelfile"
#: The variable with the Ditto's token or password.
SECRET = "DITTO_SECRET"
PORT = 8080
#: Prints why the agent is not ready; of a probe over HTTP Kubernetes keeps only the status.
PROBE = ("python3", "-m", "rigel_muto.agent.probe")
USER = 65532
#: A deploy has threads of its own, and glibc has a heap for each of many threads.
MEMORY = ({"name": "MALLOC_ARENA_MAX", "value": "2"},)
RESOURCES: dict[str, Any] = {
    "requests": {"cpu": "20m", "memory": "96Mi"},
    "limits": {"memory": "512Mi"},
}
CONFIG_ANNOTATION = "rigel-k8s/configuration"
RBAC = "rbac.authorization.k8s.io"

Object = dict[str, Any]


def agent_objects(
    around: ReleaseContext, options: MutoAgent, rigelfile: str, rules: Sequence[Object]
) -> Iterator[Object]:
    """Yield all that an agent needs.

    Args:
        rigelfile: the text of a Rigelfile with the job that commands deploy.
        rules: the rights to deploy that into the agent's namespace.
    """
    name = around.release
    meta = around.metadata(name)
    yield config_map(around, name, {FILE: rigelfile}, part_of=name)
    yield {"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta}
    yield {"apiVersion": f"{RBAC}/v1", "kind": "Role", "metadata": meta, "rules": list(rules)}
    yield {
        "apiVersion": f"{RBAC}/v1",
        "kind": "RoleBinding",
        "metadata": meta,
        "roleRef": {"apiGroup": RBAC, "kind": "Role", "name": name},
        "subjects": [{"kind": "ServiceAccount", "name": name, "namespace": around.namespace}],
    }
    yield deployment(
        around,
        name,
        _make_pod(around, options),
        strategy={"type": "Recreate"},
        pod_annotations={CONFIG_ANNOTATION: hashlib.sha256(rigelfile.encode()).hexdigest()[:20]},
    )


def _make_pod(around: ReleaseContext, options: MutoAgent) -> Object:
    volumes: list[Object] = [
        {"name": "rigelfile", "configMap": {"name": around.release}},
        {"name": "tmp", "emptyDir": {"sizeLimit": "64Mi"}},
    ]
    if options.broker_secret:
        volumes.append({"name": "broker", "secret": {"secretName": str(options.broker_secret)}})
    return {
        "serviceAccountName": around.release,
        "containers": [_make_container(around, options)],
        "volumes": volumes,
        "securityContext": pod_context(USER),
        "terminationGracePeriodSeconds": 30,
    }


def _make_container(around: ReleaseContext, options: MutoAgent) -> Object:
    look = {"exec": {"command": [*PROBE, str(PORT)]}, "timeoutSeconds": 10}
    file = {"name": "rigelfile", "mountPath": f"{DIRECTORY}/{FILE}", "subPath": FILE}
    mounts: list[Object] = [{**file, "readOnly": True}, {"name": "tmp", "mountPath": "/tmp"}]
    if options.broker_secret:
        mounts.append({"name": "broker", "mountPath": CREDENTIALS, "readOnly": True})
    env: list[Object] = [{"name": "HOME", "value": "/tmp"}, *MEMORY]
    if options.twin_secret:
        key = "password" if options.twin_user else "token"
        ref = {"name": str(options.twin_secret), "key": key}
        env.append({"name": SECRET, "valueFrom": {"secretKeyRef": ref}})
    return drop_empty(
        {
            "name": "muto-agent",
            "image": str(options.image or AGENT_IMAGE),
            "args": list(list_arguments(options, around.namespace)),
            "env": env,
            "ports": [{"name": "health", "containerPort": PORT}],
            "readinessProbe": {**look, "periodSeconds": 5},
            "resources": _choose_resources(options.resources),
            "securityContext": {
                "allowPrivilegeEscalation": False,
                "capabilities": {"drop": ["ALL"]},
                "readOnlyRootFilesystem": True,
            },
            "volumeMounts": mounts,
        }
    )


def _choose_resources(said: Resources) -> Object:
    """Return requests and limits, the defaults below the user's values."""
    asked = {"requests": said.requests, "limits": said.limits}
    return {
        kind: {**RESOURCES[kind], **{str(name): str(value) for name, value in values.items()}}
        for kind, values in asked.items()
    }


def list_arguments(options: MutoAgent, namespace: str) -> Iterator[str]:
    """Yield the words that start the agent with these options."""
    yield from ("--trust", "-f", f"{DIRECTORY}/{FILE}", "-n", namespace, "muto", "agent")
    yield from ("--health", str(PORT))
    secret = SECRET if options.twin_secret else None
    words = {
        "--job": options.job,
        "--thing": options.thing,
        "--broker": options.broker,
        "--credentials": CREDENTIALS if options.broker_secret else None,
        "--prefix": options.prefix,
        "--target": options.target,
        "--twin-url": options.twin_url,
        "--user": options.twin_user,
        "--password" if options.twin_user else "--token": secret,
    }
    for word, value in words.items():
        if value is not None:
            yield from (word, value)
    for pattern in options.stacks or ():
        yield from ("--allow-stack", pattern)
    for pattern in options.images or ():
        yield from ("--allow-image", pattern)
    if options.whole_stacks:
        yield "--whole-stacks"
