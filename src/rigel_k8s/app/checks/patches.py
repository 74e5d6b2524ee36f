"""What is wrong with raw parts of a Deployment or Job: fixed fields, and the shape of others.

Kubernetes checks every field; these are the ones that our own code reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.objects.raw import mapping, pod_of
from rigel_k8s.option_text import text_of
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile import find_nearest

#: What both need; null would remove it.
NEEDED = frozenset({"metadata", "spec", "template", "containers"})
#: Fields whose own fields are checked, too. Others may have any: a label may be called `env`.
INNER = NEEDED | {"initContainers"}
MAPPINGS = frozenset(
    {"metadata", "labels", "annotations", "spec", "strategy", "template"}
    | {"nodeSelector", "affinity", "securityContext", "resources", "lifecycle"}
    | {"startupProbe", "readinessProbe", "livenessProbe"}
)
#: What a patch may repeat: the API version, by the kind.
TOP = {"Deployment": "apps/v1", "Job": "batch/v1"}
#: The fields of Kubernetes 1.33: of a Deployment's and a Job's spec, of a pod's, of a container.
FIELDS = {
    "Deployment": """
        minReadySeconds paused progressDeadlineSeconds replicas revisionHistoryLimit selector
        strategy template
        """,
    "Job": """
        activeDeadlineSeconds backoffLimit backoffLimitPerIndex completionMode completions managedBy
        manualSelector maxFailedIndexes parallelism podFailurePolicy podReplacementPolicy selector
        successPolicy suspend template ttlSecondsAfterFinished
        """,
    "POD": """
        activeDeadlineSeconds affinity automountServiceAccountToken containers dnsConfig dnsPolicy
        enableServiceLinks ephemeralContainers hostAliases hostIPC hostNetwork hostPID hostUsers
        hostname hostnameOverride imagePullSecrets initContainers nodeName nodeSelector os overhead
        preemptionPolicy priority priorityClassName readinessGates resourceClaims resources
        restartPolicy runtimeClassName schedulerName schedulingGates securityContext
        serviceAccount serviceAccountName setHostnameAsFQDN shareProcessNamespace subdomain
        terminationGracePeriodSeconds tolerations topologySpreadConstraints volumes
        """,
    "CONTAINER": """
        args command env envFrom image imagePullPolicy lifecycle livenessProbe name ports
        readinessProbe resizePolicy resources restartPolicy restartPolicyRules securityContext
        startupProbe stdin stdinOnce terminationMessagePath terminationMessagePolicy tty
        volumeDevices volumeMounts workingDir
        """,
}
KNOWN = {kind: frozenset(text.split()) for kind, text in FIELDS.items()}
POD, CONTAINER = KNOWN["POD"], KNOWN["CONTAINER"]
#: Lists of mappings.
LISTS = frozenset(
    {"containers", "initContainers", "volumes", "tolerations", "imagePullSecrets", "hostAliases"}
    | {"env", "envFrom", "ports", "volumeMounts"}
)


def check_patch(path: Path, tree: Mapping[str, Any], kind: str = "Deployment") -> Iterator[Problem]:
    """Yield what is wrong with a part of a workload that is merged into the generated one."""
    for field in (("metadata", "name"), ("metadata", "namespace"), ("spec", "selector")):
        above = tree.get(field[0])
        if isinstance(above, Mapping) and above.get(field[1]) is not None:
            message = f"{'.'.join(field)} identifies the release and cannot change"
            yield Problem((*path, *field), message, "fixed-field", at_key=True)
    for key, value in {"apiVersion": TOP[kind], "kind": kind}.items():
        if tree.get(key) not in (None, value):
            message = f"{key} of a {kind} is {value}: remove it"
            yield Problem((*path, key), message, "fixed-field", at_key=True)
    yield from check_fields(path, tree, kind)
    yield from check_texts(path, tree)
    yield from check_shape(path, (), tree, kind)


def check_fields(path: Path, tree: Mapping[str, Any], kind: str) -> Iterator[Problem]:
    """Yield fields that are probably misspelt: Kubernetes has none such, but a similar one."""
    pod = ("spec", "template", "spec")
    found: list[tuple[Path, Any, frozenset[str]]] = [
        ((), tree, frozenset({"apiVersion", "kind", "metadata", "spec"})),
        (("spec",), tree.get("spec"), KNOWN[kind]),
        (pod, pod_of(tree), POD),
    ]
    for key in ("containers", "initContainers"):
        listed = pod_of(tree).get(key)
        for index, one in enumerate(listed if isinstance(listed, list) else ()):
            found.append(((*pod, key, index), one, CONTAINER))
    for place, fields, known in found:
        for key in map(str, fields if isinstance(fields, Mapping) else ()):
            if key not in known and key in POD and len(place) < len(pod):
                message = f"{key} is a field of the pod: write it below {show(pod)}"
                yield Problem((*path, *place, key), message, "unknown-key", at_key=True)
            elif key not in known and (near := find_nearest(key, known)):
                message = f'unknown field "{key}", did you mean "{near}"?'
                yield Problem((*path, *place, key), message, "unknown-key", at_key=True)


def check_texts(path: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield labels and annotations that are no texts."""
    template = mapping(mapping(tree.get("spec")).get("template"))
    for place, metadata in (
        (("metadata",), tree.get("metadata")),
        (("spec", "template", "metadata"), template.get("metadata")),
    ):
        for key in ("labels", "annotations"):
            for name, value in mapping(mapping(metadata).get(key)).items():
                if isinstance(value, bool | int | float):
                    message = f'{key} are texts: write "{text_of(value)}" in quotes'
                    yield Problem((*path, *place, key, str(name)), message, "wrong-type")


def check_shape(path: Path, field: Path, tree: Mapping[str, Any], kind: str) -> Iterator[Problem]:
    """Yield the values that are not of the shape that Kubernetes gives their fields.

    Args:
        path: where the patch is in the options.
        field: where `tree` is in the patch.
    """
    for key, value in tree.items():
        here = (*field, str(key))
        if value is None and key in NEEDED:
            message = f"{show(here)} cannot be removed: a {kind} needs it"
            yield Problem((*path, *here), message, "fixed-field", at_key=True)
        elif value is None or key not in MAPPINGS | LISTS:
            continue
        elif key in LISTS and (isinstance(value, str) or not isinstance(value, Sequence)):
            yield wrong_type(path, here, f"of a {kind} must be a list", value)
        else:
            listed = [(here, value)]
            if key in LISTS:
                listed = [((*here, index), item) for index, item in enumerate(value)]
            for place, item in listed:
                if not isinstance(item, Mapping):
                    yield wrong_type(path, place, f"of a {kind} must be a mapping", item)
                elif key in INNER:
                    yield from check_shape(path, place, item, kind)


def wrong_type(path: Path, field: Path, rule: str, value: object) -> Problem:
    """Return the problem of a value of a kind that Kubernetes refuses there."""
    names = {type(None): "empty", str: "text", bool: "true or false", int: "a number"}
    other = {float: "a number", dict: "a mapping"}.get(type(value), "a list")
    message = f"{show(field)} {rule}, not {names.get(type(value), other)}"
    return Problem((*path, *field), message, "wrong-type")


def show(field: Path) -> str:
    """Return a field as people write it: spec.template.spec.containers[0].env."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in field).lstrip(".")
