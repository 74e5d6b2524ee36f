"""Who has the role `edit` deploys without a gate, and is told so."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

from .rights import write_kubeconfig

pytestmark = pytest.mark.cluster

EDITOR = "editor"


@pytest.fixture(scope="module")
def namespace(cluster: Any) -> Iterator[str]:
    """A namespace in which the service account `editor` has the role `edit`."""
    name = f"t-rights-{uuid.uuid4().hex[:6]}"
    api = "rbac.authorization.k8s.io"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    meta = {"name": EDITOR, "namespace": name}
    cluster.create({"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta})
    cluster.create(
        {
            "apiVersion": f"{api}/v1",
            "kind": "RoleBinding",
            "metadata": meta,
            "roleRef": {"apiGroup": api, "kind": "ClusterRole", "name": "edit"},
            "subjects": [{"kind": "ServiceAccount", **meta}],
        }
    )
    yield name
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


def test_an_editor_is_told_to_leave_the_gate_out(
    cluster: Any, namespace: str, context: str, rigel: Any, tmp_path: Path
) -> None:
    """The error names the key, the doctor the rights; without the gate all rights are there."""
    config = write_kubeconfig(cluster, namespace, EDITOR, context, tmp_path)

    def call(*words: str, **options: Any) -> Any:
        job = {"image": "r/app:1", "nodes": {"talker": {"args": ["talk"]}}, **options}
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
        file = tmp_path / "Rigelfile"
        file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
        place = ("-f", str(file), "--kubeconfig", str(config), "--context", "x", "-n", namespace)
        return rigel(*place, *words, check=False)

    refused = call("run", "job", "deploy")
    assert refused.returncode == 1
    assert "roles.rbac.authorization.k8s.io: create, list, patch" in refused.stderr
    assert "`gate: false`" in refused.stderr
    asked = call("doctor")
    assert "ROS 1 needs `gate: false`" in asked.stdout
    assert asked.returncode == 0, "nothing else is missing: machines need not be seen"
    assert "Deployment" in call("diff", gate=False).stdout
