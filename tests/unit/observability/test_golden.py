"""Each variant of the stack has a golden file: a changed template restarts a part of it."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.release.types import Desired
from rigel_lab.cluster.layout import BOUND
from tests.support.golden import Golden

from .shapes import GOLDEN, release

EXISTING = """
existing:
  prometheus: {labels: {release: kube-prometheus-stack}}
  loki: {url: "http://loki.logging:3100/", tenant: robots, secret: loki-user}
  grafana: {labels: {shown: "yes"}, folder: Robots}
kube_state_metrics: true
node_exporter: true
"""
EVERYTHING = """
collector: promtail
collect: all
placement: {node: cloud-1, labels: {site: cloud}}
node_exporter: {image: "registry.lab/node-exporter:1"}
kube_state_metrics: {resources: {limits: {memory: 1Gi}}}
promtail: {image: "registry.lab/promtail:1"}
grafana: {service_type: NodePort, persistence: {enabled: true, size: 2Gi}}
prometheus:
  image: registry.lab/prometheus:1
  scrape_interval: 10s
  evaluation_interval: 20s
  retention: 30d
  alertmanagers: ["alertmanager.ops:9093"]
  persistence: {size: 50Gi, storage_class: fast}
loki:
  retention: 14d
  service_type: LoadBalancer
  resources: {requests: {cpu: "1", memory: 1Gi}, limits: {memory: 4Gi}}
  persistence: {size: 100Gi}
"""
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "default": ("{}", {"api_servers": ("10.0.0.1", "fd00::1")}),
    "everything": (EVERYTHING, {}),
    "existing": (EXISTING, {}),
    "promtail-existing": (f"collector: promtail\n{EXISTING}", {}),
    "no-storage": ("{grafana: {enabled: false}, network_policies: false}", {"claims": False}),
    "logs-only": ("{prometheus: {enabled: false}, grafana: {enabled: false}}", {}),
    "metrics-only": ("{loki: {enabled: false}, ros_metrics: false}", {}),
}


def made(case: str) -> Desired:
    """Return the release of a case."""
    text, more = CASES[case]
    return release(text, **more)


FOLDER = Golden(GOLDEN, lambda case: made(case).objects, ("default", "everything"), CASES)


@pytest.mark.parametrize("case", sorted(CASES))
def test_manifests_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    """The same options give the same objects, to the last field."""
    FOLDER.compare(case, update=update_golden)


def test_claims_outlive_the_stack() -> None:
    """`down` leaves what holds data."""
    kept = {ref.name for ref in made("everything").protected}
    assert kept == {"loki-data", "prometheus-data", "grafana-data"}


def test_golden_files_have_their_case() -> None:
    """No golden file outlives its case."""
    assert {path.stem for path in GOLDEN.glob("*.yaml")} == set(CASES)


def test_each_dashboard_fits_into_a_config_map() -> None:
    """The API server takes a mebibyte, with all that belongs to the object."""
    from rigel_stack import boards

    assert boards.dashboards()
    assert max(len(text.encode()) for text in boards.dashboards().values()) < 900_000


@pytest.mark.parametrize("collector", ["otel-collector", "promtail"])
def test_what_a_collector_keeps_on_a_machine_is_of_one_local_cluster(collector: str) -> None:
    """Clusters of one computer share its disk: one would send the lines of another to its Loki."""
    made = release(f"{{collector: {collector}}}")
    [pod] = [i["spec"]["template"]["spec"] for i in made.objects if i["kind"] == "DaemonSet"]
    mounts = pod["containers"][0]["volumeMounts"]
    written = {mount["name"] for mount in mounts if not mount.get("readOnly")}
    paths = [v["hostPath"]["path"] for v in pod["volumes"] if v["name"] in written]
    assert paths
    assert set(paths) <= set(BOUND)
