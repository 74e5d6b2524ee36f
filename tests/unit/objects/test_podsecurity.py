"""Which fields of a pod the Pod Security level "restricted" refuses."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.podsecurity import find_violations


def container(**security: Any) -> dict[str, Any]:
    """Return a pod's spec with one container."""
    return {"containers": [{"name": "a", "securityContext": security}]}


REFUSED = [
    ({"hostNetwork": True}, "hostNetwork"),
    ({"hostPID": True}, "hostPID"),
    ({"hostIPC": True}, "hostIPC"),
    ({"volumes": [{"name": "a", "hostPath": {"path": "/"}}]}, "volumes.0.hostPath"),
    ({"volumes": [{"name": "a", "nfs": {}}]}, "volumes.0.nfs"),
    ({"securityContext": {"runAsUser": 0}}, "securityContext.runAsUser"),
    ({"securityContext": {"runAsNonRoot": False}}, "securityContext.runAsNonRoot"),
    (
        {"securityContext": {"seccompProfile": {"type": "Unconfined"}}},
        "securityContext.seccompProfile.type",
    ),
    (
        {"securityContext": {"appArmorProfile": {"type": "Unconfined"}}},
        "securityContext.appArmorProfile.type",
    ),
    ({"securityContext": {"sysctls": [{"name": "kernel.msgmax"}]}}, "securityContext.sysctls.0"),
    (
        {"securityContext": {"seLinuxOptions": {"type": "spc_t"}}},
        "securityContext.seLinuxOptions.type",
    ),
    (
        {"securityContext": {"seLinuxOptions": {"role": "system_r"}}},
        "securityContext.seLinuxOptions.role",
    ),
    (
        {"securityContext": {"windowsOptions": {"hostProcess": True}}},
        "securityContext.windowsOptions.hostProcess",
    ),
    (container(privileged=True), "containers.0.securityContext.privileged"),
    *(
        (
            {kind: [{"name": "a", "securityContext": {"privileged": True}}]},
            f"{kind}.0.securityContext.privileged",
        )
        for kind in ("initContainers", "ephemeralContainers")
    ),
    (
        container(allowPrivilegeEscalation=True),
        "containers.0.securityContext.allowPrivilegeEscalation",
    ),
    (
        container(capabilities={"add": ["NET_BIND_SERVICE", "SYS_NICE"]}),
        "containers.0.securityContext.capabilities.add.1",
    ),
    (container(procMount="Unmasked"), "containers.0.securityContext.procMount"),
    (
        {"initContainers": [{"name": "a", "securityContext": {"runAsUser": 0}}]},
        "initContainers.0.securityContext.runAsUser",
    ),
    (
        {"containers": [{"name": "a", "ports": [{"containerPort": 1, "hostPort": 1}]}]},
        "containers.0.ports.0.hostPort",
    ),
]


@pytest.mark.parametrize(("spec", "place"), REFUSED, ids=[place for _, place in REFUSED])
def test_what_the_level_refuses_is_found_where_it_stands(spec: dict[str, Any], place: str) -> None:
    """One value, one violation, with its path."""
    assert [".".join(map(str, path)) for path, _ in find_violations(spec)] == [place]


def test_what_the_level_allows_is_no_violation() -> None:
    """A part of a pod may leave fields out: they are filled in elsewhere."""
    spec = {
        "hostNetwork": False,
        "volumes": [{"name": "a", "emptyDir": {}}, {"name": "b", "persistentVolumeClaim": {}}],
        "securityContext": {
            "runAsUser": 7,
            "seccompProfile": {"type": "Localhost"},
            "sysctls": [{"name": "net.ipv4.tcp_syncookies"}],
            "seLinuxOptions": {"type": "container_t"},
        },
        "containers": [
            {"name": "a", "ports": [{"containerPort": 1}]},
            {"name": "b", "securityContext": {"capabilities": {"add": ["NET_BIND_SERVICE"]}}},
        ],
    }
    assert list(find_violations(spec)) == []


@pytest.mark.parametrize("spec", [{"volumes": "x"}, {"containers": [1]}, {"securityContext": None}])
def test_what_is_not_of_the_expected_form_is_left_to_kubernetes(spec: dict[str, Any]) -> None:
    """A patch is the user's own text."""
    assert list(find_violations(spec)) == []
