"""What Kubernetes' Pod Security level "restricted" refuses in a pod's spec, whole or in part; pure.

The level also requires fields; `app/security.py` fills them in, with `pod_context`, which the
stack's pods have too. Here are the values that no one can fill in, because something else is
written there. Source: kubernetes.io, Pod Security Standards.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.objects.overlay import mapping

Path = tuple[str | int, ...]
Violation = tuple[Path, str]

HOST_NAMESPACES = ("hostNetwork", "hostPID", "hostIPC")
CONTAINER_LISTS = ("initContainers", "containers", "ephemeralContainers")
VOLUME_SOURCES = frozenset(
    {
        "configMap",
        "csi",
        "downwardAPI",
        "emptyDir",
        "ephemeral",
        "persistentVolumeClaim",
        "projected",
        "secret",
    }
)
#: Fields of a volume that are not its source.
VOLUME_FIELDS = frozenset({"name", "$patch"})
CAPABILITIES = frozenset({"NET_BIND_SERVICE"})
PROFILES = frozenset({"RuntimeDefault", "Localhost"})
SELINUX_TYPES = frozenset(
    {"", "container_t", "container_init_t", "container_kvm_t", "container_engine_t"}
)
SYSCTLS = frozenset(
    {
        "kernel.shm_rmid_forced",
        "net.ipv4.ip_local_port_range",
        "net.ipv4.ip_local_reserved_ports",
        "net.ipv4.ip_unprivileged_port_start",
        "net.ipv4.ping_group_range",
        "net.ipv4.tcp_fin_timeout",
        "net.ipv4.tcp_keepalive_intvl",
        "net.ipv4.tcp_keepalive_probes",
        "net.ipv4.tcp_keepalive_time",
        "net.ipv4.tcp_rmem",
        "net.ipv4.tcp_syncookies",
        "net.ipv4.tcp_wmem",
    }
)


def pod_context(user: int) -> dict[str, Any]:
    """Return a pod's securityContext: one user, never root, who may write to the pod's volumes."""
    return {
        "runAsNonRoot": True,
        "runAsUser": user,
        "runAsGroup": user,
        "fsGroup": user,
        "fsGroupChangePolicy": "OnRootMismatch",
        "seccompProfile": {"type": "RuntimeDefault"},
    }


def find_violations(spec: Mapping[str, Any]) -> Iterator[Violation]:
    """Yield (path, what is refused) for a pod's spec or for a patch of one."""
    for name in HOST_NAMESPACES:
        if spec.get(name):
            yield (name,), f"{name}: true"
    for path, volume in items(spec.get("volumes"), "volumes"):
        for source in volume:
            if source not in VOLUME_FIELDS | VOLUME_SOURCES:
                yield (*path, source), f"a volume of kind {source}"
    security = mapping(spec.get("securityContext"))
    yield from under(("securityContext",), find_in_context(security))
    for path, sysctl in items(security.get("sysctls"), "securityContext", "sysctls"):
        if not is_among(sysctl.get("name"), SYSCTLS):
            yield path, f"the sysctl {sysctl.get('name')}"
    for kind in CONTAINER_LISTS:
        for path, container in items(spec.get(kind), kind):
            own = mapping(container.get("securityContext"))
            yield from under((*path, "securityContext"), find_in_context(own))
            for place, port in items(container.get("ports"), *path, "ports"):
                if port.get("hostPort"):
                    yield (*place, "hostPort"), f"hostPort: {port['hostPort']}"


def find_in_context(context: Mapping[str, Any]) -> Iterator[Violation]:
    """Yield what is refused in the securityContext of a pod or of a container."""
    for name, wrong in (
        ("privileged", True),
        ("allowPrivilegeEscalation", True),
        ("runAsNonRoot", False),
    ):
        if context.get(name) is wrong:
            yield (name,), f"{name}: {str(wrong).lower()}"
    user = context.get("runAsUser")
    if user in (0, "0"):
        yield ("runAsUser",), "runAsUser: 0"
    added = mapping(context.get("capabilities")).get("add")
    for index, name in enumerate(added if isinstance(added, list | tuple) else ()):
        if not is_among(name, CAPABILITIES):
            yield ("capabilities", "add", index), f"the capability {name}"
    for field in ("seccompProfile", "appArmorProfile"):
        profile = mapping(context.get(field)).get("type")
        if profile is not None and not is_among(profile, PROFILES):
            yield (field, "type"), f"{field}: {profile}"
    if context.get("procMount") not in (None, "Default"):
        yield ("procMount",), f"procMount: {context['procMount']}"
    selinux = mapping(context.get("seLinuxOptions"))
    if selinux.get("type") is not None and not is_among(selinux["type"], SELINUX_TYPES):
        yield ("seLinuxOptions", "type"), f"the SELinux type {selinux['type']}"
    for name in ("user", "role"):
        if selinux.get(name):
            yield ("seLinuxOptions", name), f"an SELinux {name}"
    if mapping(context.get("windowsOptions")).get("hostProcess"):
        yield ("windowsOptions", "hostProcess"), "hostProcess: true"


def is_among(value: Any, allowed: Collection[str]) -> bool:
    """Return whether a value is one of these texts; a patch may hold a list in its place."""
    return isinstance(value, str) and value in allowed


def items(value: Any, *path: str | int) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """Yield the mappings of a list, each with its path; anything else gives nothing."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        for index, item in enumerate(value):
            if isinstance(item, Mapping):
                yield (*path, index), item


def under(path: Path, found: Iterator[Violation]) -> Iterator[Violation]:
    """Yield violations with their paths below another one."""
    for below, what in found:
        yield (*path, *below), what
