"""What the modes with a server in the middle share: a server is a Deployment of one pod.

It is behind a Service with a cluster address, so that clients find it again wherever it starts.
"""

from __future__ import annotations

from collections.abc import Sequence

from rigel_k8s.network.files import make_context
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan
from rigel_k8s.objects.marks import FIRST_ANNOTATION, NAME_LABEL
from rigel_k8s.objects.naming import HOSTNAME
from rigel_k8s.objects.podoptions import Machines
from rigel_k8s.objects.pods import Object, drop_empty, inpod_volume, stop_hook, tolerations
from rigel_k8s.objects.text import split_words
from rigel_k8s.objects.workloads import deployment, service

#: The options of `network` that describe a server.
SERVER_KEYS = frozenset({"image", "command", "service_account", "placement"})


def command_line(network: Network, default: Sequence[str]) -> list[str]:
    """Return what the image's ENTRYPOINT runs."""
    return split_words(network.command) if network.command else list(default)


def environment(sources: dict[str, Object]) -> list[Object]:
    """Return a container's environment."""
    return [{"name": name, **source} for name, source in sources.items()]


def server_probes(check: Object) -> Object:
    """Return the probes of a server: a frequent one until it has started, a rare one afterwards."""
    return {
        "startupProbe": {**check, "periodSeconds": 1, "failureThreshold": 300},
        "readinessProbe": {**check, "periodSeconds": 10},
    }


def container_port(name: str, number: int, protocol: str) -> Object:
    """Return the container's side of a port."""
    return {"name": name, "containerPort": number, "protocol": protocol}


def server_service(plan: NetworkPlan, name: str, number: int, protocol: str) -> Object:
    """Return the Service by which clients reach a server."""
    entry = {"name": "server", "port": number, "targetPort": number, "protocol": protocol}
    made = service(make_context(plan), name, [entry])
    if protocol == "UDP":
        made["spec"]["ipFamilies"] = ["IPv4"]  # Fast DDS is configured for IPv4 only
    return made


def server_deployment(
    plan: NetworkPlan,
    network: Network,
    name: str,
    container: Object,
    *,
    earlier: Sequence[str] = (),
) -> Object:
    """Return a server's Deployment: it starts before its clients, and never runs twice at once.

    Its pods have no network annotation, since they are not examined for discovering each other.

    Args:
        earlier: servers from which it is kept apart if there are machines enough. They need not
            name it: the scheduler reads such a wish in both directions.
    """
    volume, mount = inpod_volume(plan.release)
    image = str(
        network.image or (plan.pods[0].image if plan.pods else make_context(plan).default_image)
    )
    whole = {
        **container,
        "image": image,
        "lifecycle": stop_hook(),
        "volumeMounts": [mount],
    }
    account = network.service_account
    place = network.placement or Machines()
    pod = {
        "affinity": prefer_apart(earlier),
        "nodeSelector": place.node_selector,
        "tolerations": tolerations([], pinned=place.machine is not None),
        "containers": [whole],
        "volumes": [volume],
        "serviceAccountName": account,
    }
    return deployment(
        make_context(plan),
        name,
        drop_empty(pod),
        strategy={"type": "Recreate"},
        annotations={FIRST_ANNOTATION: "true"},
    )


def prefer_apart(others: Sequence[str]) -> Object:
    """Return the affinity of a pod for machines without the pods of some workloads."""
    if not others:
        return {}
    names = {"key": NAME_LABEL, "operator": "In", "values": list(others)}
    term = {"labelSelector": {"matchExpressions": [names]}, "topologyKey": HOSTNAME}
    preferred = [{"weight": 100, "podAffinityTerm": term}]
    return {"podAntiAffinity": {"preferredDuringSchedulingIgnoredDuringExecution": preferred}}
