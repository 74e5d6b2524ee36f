"""What goes wrong with ROS raises its alert in a running Prometheus, and a deploy raises none.

How long each waits before it fires is what promtool tests (tests/unit/observability/boards). Here
one fires, and ends; another one is raised, with its labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

from .conftest import Troubled, until

pytestmark = pytest.mark.cluster


def raised(troubled: Troubled, **labels: str) -> list[dict[str, Any]]:
    """Return the alerts with these labels, whether they fire or still wait for their time."""
    chosen = ", ".join(f'{name}="{value}"' for name, value in labels.items())
    return troubled.watch.now(f"ALERTS{{{chosen}}}")


def firing(troubled: Troubled, **labels: str) -> list[dict[str, Any]]:
    """Return those that fire."""
    return raised(troubled, alertstate="firing", **labels)


def test_a_deploy_alone_raises_nothing(quiet: Sequence[dict[str, Any]]) -> None:
    """Two applications were deployed, and nobody was called."""
    assert [alert["metric"] for alert in quiet] == []


def test_a_killed_node_is_told_of(troubled: Troubled) -> None:
    """The node is dead, its pod is Ready: Kubernetes sees nothing, the alert does."""
    wanted = {"alertname": "RosNodeGone", "namespace": troubled.sick, "ros_node": "/victim"}
    (alert,) = until(lambda: raised(troubled, **wanted), "RosNodeGone of /victim")
    ready = (
        f'kube_pod_status_ready{{namespace="{troubled.sick}", pod=~"victim-.*", condition="true"}}'
    )
    assert [sample["value"][1] for sample in troubled.watch.now(ready)] == ["1"]
    labels = {key: alert["metric"].get(key) for key in ("severity", "application", "workload")}
    assert labels == {"severity": "critical", "application": "sick", "workload": "victim"}


def test_a_restarted_roscore_and_its_lost_nodes_are_told_of(troubled: Troubled) -> None:
    """One alert for the application: the master is new, and /talker is lost to it."""
    wanted = {"alertname": "RosMasterRestarted", "namespace": troubled.forgetful}
    (alert,) = until(lambda: firing(troubled, **wanted), "RosMasterRestarted")
    assert alert["metric"]["application"] == "forgetful"
    lost = f'ros_node:ros_node_orphaned:info{{namespace="{troubled.forgetful}"}}'
    assert [sample["metric"]["ros_node"] for sample in troubled.watch.now(lost)] == ["/talker"]
    others = firing(troubled, namespace=troubled.forgetful)
    names = {alert["metric"]["alertname"] for alert in others}
    assert not names & {"RosNodeGone", "RosTopicSilent"}


def test_restarting_the_lost_nodes_ends_the_alert(troubled: Troubled, cluster: Any) -> None:
    """What the runbook says to do is what helps."""
    wanted = {"alertname": "RosMasterRestarted", "namespace": troubled.forgetful}
    until(lambda: firing(troubled, **wanted), "RosMasterRestarted")
    ref = ObjectRef("apps/v1", "Deployment", troubled.forgetful, "talker")
    stamp = {"metadata": {"annotations": {"kubectl.kubernetes.io/restartedAt": "now"}}}
    cluster.patch(ref, {"spec": {"template": stamp}})
    until(lambda: not firing(troubled, **wanted), "the end of RosMasterRestarted")
