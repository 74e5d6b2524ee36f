"""docs/alerts.md: every alert of our rules."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from rigel_stack.boards import rules
from tools.reference.meanings import CONDITIONS
from tools.reference.tables import draw_table, join_page

HEAD = """# Alerts

Every alert of [our rules](dashboards.md), most severe first: when it fires, and the page that
says what to do. This page is generated from the rules.

Each alert has the labels `severity`, `namespace` and `application`, and `workload`, `ros_node`,
`topic` or `node` if they are known. Critical: the robot does not do its work. Warning: soon, or
in part. Info: look when you have time. [Why a roll-out fires
none](dashboards.md#why-a-roll-out-fires-none) explains the times.

## Who is notified

Alerts appear in Grafana and in `rigel observe status`. The stack has no Alertmanager, so it sends
no mail and no message. If you have one, name its address:

```yaml
observability:
  enabled: true
  prometheus: { alertmanagers: ["alertmanager.monitoring:9093"] }
```

It is reached over plain HTTP, without a login. For one that needs TLS or a login, let your own
Prometheus evaluate the rules ([`existing.prometheus`](observability.md)).

## All alerts"""

SEVERITIES = ("critical", "warning", "info")


GAPS = """## What no alert covers

These have no alert of their own. The stack's Prometheus has series of kube-state-metrics for the
first two. A query returns a line for each case:

- **A machine is lost**, such as a robot that is [offline](offline.md). Depending on which pods run
  there, RosMasterGone, RosNodeGone or RosExporterDown fires.

```
kube_node_status_condition{condition="Ready", status="true"} == 0
```

- **A pod of a release does not start**: no machine accepts it, or its image cannot be pulled. The
  second query shows only the latter.

```
kube_pod_status_phase{phase="Pending"} == 1 and on (namespace, pod) pod:rigel_identity:info
```

```
kube_pod_container_status_waiting_reason{reason=~"ImagePullBackOff|ErrImagePull"} == 1
  and on (namespace, pod) pod:rigel_identity:info
```

- **A ROS 1 node receives nothing** although it is registered: [find out
  why](ros1-hears-nothing.md). RosTopicSilent fires only if the exporter, too, receives nothing.

`rigel observe` opens Prometheus, where you can try a query. To be notified, make a rule of it in a
Prometheus of your own, for at least 10 minutes: a roll-out is `Pending` for a while."""


def write_alerts() -> str:
    """Return the page."""
    return join_page(_list_parts())


def list_rules() -> Iterator[Mapping[str, Any]]:
    """Yield all rules of all files, in their order."""
    for text in rules().values():
        for group in yaml.safe_load(text)["groups"]:
            yield from group["rules"]


def _list_parts() -> Iterator[str]:
    yield HEAD
    alerts = [rule for rule in list_rules() if "alert" in rule]
    alerts.sort(key=lambda rule: SEVERITIES.index(rule["labels"]["severity"]))
    rows = (
        (
            f"[{rule['alert']}](runbooks/{rule['alert']}.md)",
            rule["labels"]["severity"],
            CONDITIONS[rule["alert"]],
            rule["for"],
        )
        for rule in alerts
    )
    yield draw_table(("alert", "severity", "fires when", "for"), rows)
    yield GAPS
