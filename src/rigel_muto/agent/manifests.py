"""The agent as objects of Kubernetes: a Deployment with a Role for its namespace; pure."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any

import yaml

from rigel_k8s import __version__
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.objects.workloads import ReleaseContext, config_map, deployment
from rigel_k8s.yaml_text import Loader
from rigel_muto.agent.options import MutoAgent

#: What `rigel image muto-agent` builds.
AGENT_IMAGE = f"ghcr.io/rigel-k8s/muto-agent:{__version__}"
#: Where the pod has the files for the broker.
CREDENTIALS = "/etc/rigel-k8s-broker"
#: The variable with the Ditto's token or password.
SECRET = "DITTO_SECRET"
USER = 65532
CONFIG_ANNOTATION = "rigel-k8s/configuration"
RBAC = "rbac.authorization.k8s.io"

Object = dict[str, Any]


def agent_objects(
    release: ReleaseContext, options: MutoAgent, rigelfile: str, rules: Sequence[Object]
) -> Iterator[Object]:
    """Yield all that an agent needs.

    Args:
        rigelfile: the text of a Rigelfile with the job that commands deploy.
        rules: the rights to deploy that into the agent's namespace.
    """
    name = release.release
    meta = release.metadata(name)
    yield config_map(release, name, {"Rigelfile": rigelfile}, part_of=name)
    yield {"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta}
    yield {"apiVersion": f"{RBAC}/v1", "kind": "Role", "metadata": meta, "rules": list(rules)}
    yield {
        "apiVersion": f"{RBAC}/v1",
        "kind": "RoleBinding",
        "metadata": meta,
        "roleRef": {"apiGroup": RBAC, "kind": "Role", "name": name},
        "subjects": [{"kind": "ServiceAccount", "name": name, "namespace": release.namespace}],
    }
    yield deployment(
        release,
        name,
        _make_pod(release, options),
        strategy={"type": "Recreate"},
        pod_annotations={CONFIG_ANNOTATION: hashlib.sha256(rigelfile.encode()).hexdigest()[:20]},
    )


def _make_pod(release: ReleaseContext, options: MutoAgent) -> Object:
    text = files(__package__).joinpath("pod.yaml").read_text("utf-8")
    pod: Object = yaml.load(text, Loader)
    [container] = pod["containers"]
    pod["serviceAccountName"] = pod["volumes"][0]["configMap"]["name"] = release.release
    container["image"] = str(options.image or AGENT_IMAGE)
    container["args"] = list(list_arguments(options, release.namespace))
    for kind in ("requests", "limits"):
        chosen = getattr(options.resources, kind).items()
        container["resources"][kind].update({str(name): str(value) for name, value in chosen})
    if options.twin_secret:
        key = "password" if options.twin_user else "token"
        ref = {"name": str(options.twin_secret), "key": key}
        container["env"].append({"name": SECRET, "valueFrom": {"secretKeyRef": ref}})
    if options.broker_secret:
        mount = {"name": "broker", "mountPath": CREDENTIALS, "readOnly": True}
        container["volumeMounts"].append(mount)
        secret = {"secretName": str(options.broker_secret)}
        pod["volumes"].append({"name": "broker", "secret": secret})
    return {**pod, "securityContext": pod_context(USER), "terminationGracePeriodSeconds": 30}


def list_arguments(options: MutoAgent, namespace: str) -> Iterator[str]:
    """Yield the words that start the agent with these options."""
    yield from ("--trust", "-f", "/etc/rigel-k8s/Rigelfile", "-n", namespace, "muto", "agent")
    yield from ("--health", "8080")
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
