"""examples/src-plugin shows every key of src.plugin's, and passes the check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.jobs import registry
from rigel_k8s.rigelfile import check_file

EXAMPLE = Path(__file__).parents[3] / "examples" / "src-plugin" / "Rigelfile"

#: What src.plugin reads, as dotted paths; lists are entered.
PEER = """
deploy_ros_master namespace deployment_name application_image ros_master_image
readiness.command readiness.initial_delay_seconds readiness.period_seconds readiness.timeout_seconds
rolling_update.strategy rolling_update.max_surge rolling_update.max_unavailable
persistent_storage.volumes.name persistent_storage.volumes.size
persistent_storage.volumes.storage_class persistent_storage.volumes.host_path
persistent_storage.volumes.mount_path
distributed.enabled distributed.default_to_remote distributed.force_local_flag
observability.enabled observability.namespace observability.grafana.enabled
observability.grafana.admin_password observability.grafana.default_dashboards
observability.grafana.service_type observability.grafana.persistence.enabled
observability.grafana.persistence.size observability.prometheus.enabled
observability.prometheus.scrape_interval observability.prometheus.evaluation_interval
observability.prometheus.retention observability.prometheus.service_type
observability.loki.enabled observability.loki.retention observability.loki.service_type
observability.loki.persistence.enabled observability.loki.persistence.size
observability.node_exporter observability.ros_metrics observability_only
results.source_path results.container
additional_k8s_params.ros_master additional_k8s_params.application
""".split()  # noqa: SIM905 - a list of 42 quoted words is no easier to read


def paths(value: Any, prefix: str = "") -> Iterator[str]:
    """Yield the dotted path of every key."""
    if isinstance(value, list):
        for item in value:
            yield from paths(item, prefix)
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield f"{prefix}{key}"
            yield from paths(item, f"{prefix}{key}.")


def resolve(kind: str, name: str) -> Any:
    """Return a job type or provider, as `rigel check` does."""
    find = registry.job_type if kind == "job" else registry.provider_type
    return find(name, EXAMPLE.parent)


def test_every_key_of_the_peers_is_in_use() -> None:
    """Who comes from there finds each of them."""
    jobs = yaml.safe_load(EXAMPLE.read_text("utf-8"))["jobs"]
    used = set(paths(jobs["deploy_k8s"]["with"]["orchestration"]))
    assert set(PEER) <= used


def test_it_has_no_error_and_four_warnings() -> None:
    """Surge of a fixed name, a password in clear text, and Promtail's end in both jobs."""
    result = check_file(EXAMPLE, {}, resolve)
    assert [f.kind for f in result.errors] == []
    assert [f.kind for f in result.warnings] == [
        "surge",
        "clear-password",
    ]
