"""Dashboards as ConfigMaps: our Grafana mounts them, another Grafana's sidecar finds them."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.observability.manifests.frame import Object
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import GRAFANA

#: Where our Grafana reads them.
DIRECTORY = "/etc/grafana/dashboards"
#: The label that Grafana's sidecars look for by default.
SIDECAR_LABEL = {"grafana_dashboard": "1"}


def dashboards(stack: Stack) -> Iterator[Object]:
    """Yield a ConfigMap for each dashboard: all together may be too large for one."""
    other = stack.other_grafana
    labels = {str(k): str(v) for k, v in other.labels.items()} if other else {}
    folder = {"grafana_folder": other.folder} if other and other.folder else None
    if not stack.options.grafana.default_dashboards:
        return
    for name, text in sorted(stack.boards.dashboards.items()):
        yield stack.frame.config_map(
            config_name(name),
            {name: text},
            GRAFANA,
            own_labels=labels or SIDECAR_LABEL,
            annotations=folder,
        )


def config_name(file: str) -> str:
    """Return the name of a dashboard's ConfigMap."""
    return f"dashboard-{file.removesuffix('.json')}"
