"""Users who may do less than an administrator."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

from rigel_k8s.kube.kubeconfig import load


def write_kubeconfig(
    cluster: Any, namespace: str, account: str, context: str, directory: Path
) -> Path:
    """Write a kubeconfig for a service account, and return its place."""
    target = load(context=context)
    path = f"/api/v1/namespaces/{namespace}/serviceaccounts/{account}/token"
    request = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {}}
    answer = cluster.client.call("POST", path, "ask for a token", body=request)
    authority = base64.b64encode(target.authority.encode()).decode()
    config = {
        "clusters": [
            {
                "name": "c",
                "cluster": {"server": target.server, "certificate-authority-data": authority},
            }
        ],
        "users": [{"name": "u", "user": {"token": answer["status"]["token"]}}],
        "contexts": [{"name": "x", "context": {"cluster": "c", "user": "u"}}],
        "current-context": "x",
    }
    file = directory / "kubeconfig"
    file.write_text(json.dumps(config), "utf-8")
    return file
