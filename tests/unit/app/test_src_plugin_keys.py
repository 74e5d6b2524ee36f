"""Each of src.plugin's keys changes the objects, nested under `orchestration` or directly."""

from __future__ import annotations

from collections.abc import Callable
from textwrap import indent
from typing import Any

import pytest

from rigel_k8s.release.types import Desired

from .shapes import container, env, find, options, pod, release

BASE = "application_image: app:1\n"
Look = Callable[[Desired], Any]

#: (keys, how to look, what is there without them, what is there with them)
KEYS: list[tuple[str, Look, Any, Any]] = [
    (
        "deploy_ros_master: false",
        lambda d: [m["kind"] for m in d.objects if m["metadata"]["name"] == "ros-master"],
        ["ServiceAccount", "Role", "RoleBinding", "Service", "Deployment"],
        [],
    ),
    ("namespace: fleet", lambda d: options_namespace(d), None, "fleet"),
    (
        "deployment_name: turtle",
        lambda d: [m["metadata"]["name"] for m in d.objects if m["kind"] == "Deployment"],
        ["ros-master", "rigel-k8s-application"],
        ["ros-master", "turtle"],
    ),
    (
        "application_image: app:2",
        lambda d: container(d, "rigel-k8s-application")["image"],
        "app:1",
        "app:2",
    ),
    (
        "ros_master_image: core:1",
        lambda d: container(d, "ros-master")["image"],
        "ros:noetic-ros-core",
        "core:1",
    ),
    (
        "readiness: {command: 'probe --now'}",
        lambda d: app(d)["readinessProbe"]["exec"]["command"],
        ["/bin/sh", "/rigel-k8s/ready.sh", "node"],
        ["probe", "--now"],
    ),
    (
        "readiness: {command: probe, initial_delay_seconds: 7}",
        lambda d: app(d)["startupProbe"].get("initialDelaySeconds"),
        None,
        7,
    ),
    (
        "readiness: {command: probe, period_seconds: 7}",
        lambda d: app(d)["readinessProbe"]["periodSeconds"],
        10,
        7,
    ),
    (
        "rolling_update: {strategy: Rolling}",
        lambda d: find(d, "Deployment", "rigel-k8s-application")["metadata"]["annotations"],
        {"rigel-k8s/update": "HandOver"},
        {"rigel-k8s/update": "Rolling: `update` requests it"},
    ),
    (
        "rolling_update: {strategy: rolling, max_surge: 2}",
        lambda d: strategy(d).get("rollingUpdate", {}).get("maxSurge"),
        1,
        2,
    ),
    (
        "rolling_update: {max_unavailable: 25%}",
        lambda d: strategy(d).get("rollingUpdate", {}).get("maxUnavailable"),
        0,
        "25%",
    ),
    (
        "persistent_storage: {volumes: [{name: logs, size: 2Gi}]}",
        lambda d: [m["spec"] for m in d.objects if m["kind"] == "PersistentVolumeClaim"],
        [],
        [{"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "2Gi"}}}],
    ),
    (
        "persistent_storage: {volumes: [{name: logs, storage_class: fast}]}",
        lambda d: [
            m["spec"].get("storageClassName")
            for m in d.objects
            if m["kind"] == "PersistentVolumeClaim"
        ],
        [],
        ["fast"],
    ),
    (
        "persistent_storage: {volumes: [{name: logs, host_path: /srv/logs}]}",
        lambda d: [
            (
                m["metadata"]["name"],
                m["spec"]["hostPath"]["path"],
                m["spec"]["persistentVolumeReclaimPolicy"],
            )
            for m in d.objects
            if m["kind"] == "PersistentVolume"
        ],
        [],
        [("logs-pv", "/srv/logs", "Retain")],
    ),
    (
        "persistent_storage: {volumes: [{name: logs}]}",
        lambda d: [m["mountPath"] for m in app(d)["volumeMounts"]],
        ["/rigel-k8s"],
        ["/rigel-k8s", "/persistent/logs"],
    ),
    (
        "persistent_storage: {volumes: [{name: logs, mount_path: /logs}]}",
        lambda d: [m["mountPath"] for m in app(d)["volumeMounts"]],
        ["/rigel-k8s"],
        ["/rigel-k8s", "/logs"],
    ),
    (
        "distributed: {enabled: true, default_to_remote: true}",
        lambda d: pod(d, "rigel-k8s-application").get("nodeSelector"),
        None,
        {"deploymentType": "remote"},
    ),
    (
        "additional_k8s_params: {ros_master: {spec: {template: {spec: {hostNetwork: true}}}}}",
        lambda d: pod(d, "ros-master").get("hostNetwork"),
        None,
        True,
    ),
    (
        "additional_k8s_params: {application: {spec: {template: {spec: {containers:"
        " [{name: ros-app, env: [{name: A, value: b}]}]}}}}}",
        lambda d: env(d, "rigel-k8s-application").get("A"),
        None,
        "b",
    ),
]


def app(made: Desired) -> dict[str, Any]:
    return container(made, "rigel-k8s-application")


def strategy(made: Desired) -> dict[str, Any]:
    found: dict[str, Any] = find(made, "Deployment", "rigel-k8s-application")["spec"]["strategy"]
    return found


def options_namespace(made: Desired) -> Any:
    return made.options.get("namespace")


def both(keys: str) -> list[str]:
    """Return a job's `with` directly and nested."""
    base = "" if keys.startswith("application_image") else BASE
    flat = base + keys + "\n"
    return [flat, "orchestration:\n" + indent(flat, "  ")]


@pytest.mark.parametrize(("keys", "look", "without", "there"), KEYS, ids=[k[0] for k in KEYS])
def test_each_key_changes_the_objects_in_both_nestings(
    keys: str, look: Look, without: Any, there: Any
) -> None:
    """A key that changed nothing would be accepted and forgotten."""
    import yaml

    assert look(release(BASE)) == without
    for text in both(keys):
        assert look(release(text, raw=yaml.safe_load(text))) == there


@pytest.mark.parametrize(
    "keys",
    [
        "{enabled: false, default_to_remote: true}",
        "{enabled: true, default_to_remote: false}",
        "{enabled: true, default_to_remote: true, force_local_flag: true}",
    ],
)
def test_distributed_stays_local_unless_all_three_say_remote(keys: str) -> None:
    """src.plugin's rule: enabled, remote by default, not forced local."""
    made = release(f"{BASE}distributed: {keys}")
    assert "nodeSelector" not in pod(made, "rigel-k8s-application")


def test_observability_keys_of_both_generations_are_read() -> None:
    """src.plugin's own words, and Helm's release, chart and values."""
    text = """
observability:
  enabled: true
  namespace: watch
  grafana: {enabled: true, admin_password: x, default_dashboards: true, service_type: NodePort,
            persistence: {enabled: true, size: 2Gi}}
  prometheus: {scrape_interval: 10s, evaluation_interval: 10s, retention: 7d,
               service_type: ClusterIP}
  loki: {retention: 7d, persistence: {enabled: true, size: 5Gi}, release: loki, chart: a/b,
         values: {c: 1}}
  node_exporter: true
  ros_metrics: true
"""
    found = options(text).observability
    assert (found.namespace, found.prometheus.retention, found.loki.values) == (
        "watch",
        "7d",
        {"c": 1},
    )


def test_a_password_is_not_kept_in_revisions() -> None:
    """Everything else of the options is, so that a partial job can be laid over it."""
    raw = {
        "observability": {"grafana": {"admin_password": "secret", "enabled": True}},
        "namespace": "a",
    }
    made = release(BASE, raw={"orchestration": raw})
    assert made.options == {"observability": {"grafana": {"enabled": True}}, "namespace": "a"}
    assert raw["observability"]["grafana"]["admin_password"] == "secret"


def test_a_users_own_readiness_probe_is_the_only_one() -> None:
    """Our startup probe would hold back what the user's probe lets through."""
    made = release(
        "additional_k8s_params: {application: {spec: {template: {spec: {containers:"
        " [{name: ros-app, image: a, readinessProbe: {httpGet: {port: 80}}}]}}}}}"
    )
    found = app(made)
    assert found["readinessProbe"] == {"httpGet": {"port": 80}}
    assert "startupProbe" not in found
