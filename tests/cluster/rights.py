"""Users who may do less than an administrator."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.commands.rbac import roles, subject
from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.kube.kubeconfig import load
from rigel_k8s.settings import Settings
from tests.support.until import until

DEPLOYER, INSTALLER = "rigel-test-deployer", "rigel-test-installer"
REVIEWS = "authorization.k8s.io/v1"


def grant_role(admin: Any, namespace: str, purpose: str, user: str) -> None:
    """Give a user what `rigel rbac` prints for a purpose."""
    role, *bindings = roles(Settings(namespace=namespace), purpose, [subject("User", user)])
    for manifest in (role, *bindings):
        admin.apply(manifest)
    wait_for_right(admin, user, role["rules"][0], namespace)


def wait_for_right(admin: Any, user: str, rule: Mapping[str, Any], namespace: str = "") -> None:
    """Wait until the API server knows of a right: it hears of its own roles by watches."""
    resource, _, subresource = rule["resources"][0].partition("/")
    right = {"group": rule["apiGroups"][0], "resource": resource, "subresource": subresource}
    attributes = {**right, "verb": rule["verbs"][0], "namespace": namespace}
    asked = {"user": user, "resourceAttributes": attributes}
    until(
        lambda: admin.review(REVIEWS, "SubjectAccessReview", asked).get("allowed"),
        f"rights of {user}",
    )


def write_impersonation(context: str, user: str, directory: Path) -> Path:
    """Write a kubeconfig with which a context's user asks in another user's name."""
    named = os.environ.get("KUBECONFIG") or str(Path.home() / ".kube/config")
    for file in map(Path, named.split(os.pathsep)):
        config = yaml.safe_load(file.read_text("utf-8")) if file.exists() else {}
        found = [c["context"] for c in config.get("contexts") or [] if c["name"] == context]
        if found:
            break
    else:
        raise AssertionError(f"no kubeconfig has the context {context}")
    for entry in config["users"]:
        if entry["name"] == found[0]["user"]:
            entry["user"]["as"] = user
    made = directory / "kubeconfig"
    made.write_text(yaml.safe_dump(config), "utf-8")
    return made


def write_kubeconfig(
    cluster: Any, namespace: str, account: str, context: str, directory: Path
) -> Path:
    """Write a kubeconfig for a service account, and return its place."""
    target = load(context=context)
    path = f"/api/v1/namespaces/{namespace}/serviceaccounts/{account}/token"
    request = {"apiVersion": "authentication.k8s.io/v1", "kind": "TokenRequest", "spec": {}}
    answer = cluster.client.call("POST", path, "ask for a token", read_mapping, body=request)
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
