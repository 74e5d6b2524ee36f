"""What the API server refuses, as errors; which URL a kind has."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, ConflictError, NotFoundError
from rigel_k8s.kube.failures import Conflict, FieldConflict, Forbidden, refusal
from rigel_k8s.kube.resources import ApiResources, Resource, path


def refused(status: int, **answer: Any) -> ClusterError:
    body = json.dumps(answer).encode()
    return refusal(status, body, "apply X", context="far", server="https://k")


def test_statuses_become_the_errors_that_others_catch() -> None:
    """404, 409 and the rest, with Kubernetes' own message and reason."""
    missing = refused(404, message="pods nowhere", reason="NotFound")
    assert isinstance(missing, NotFoundError)
    assert missing.message == "cannot apply X: pods nowhere"
    assert isinstance(refused(409, message="m"), ConflictError)
    forbidden = refused(403, message="m")
    assert isinstance(forbidden, Forbidden)
    assert not isinstance(forbidden, (NotFoundError, ConflictError))
    assert not isinstance(refused(401, message="m"), Forbidden)
    assert "auth can-i" in (forbidden.hint or "")
    assert "context far" in (refused(401, message="m").hint or "")


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ('secrets "x" is forbidden: exceeded quota: q, requested: count/secrets=1', "quota raised"),
        ('"x" is forbidden: ... because namespace n is being terminated', "is being deleted"),
    ],
)
def test_a_refusal_that_is_not_about_rights_has_another_hint(message: str, words: str) -> None:
    """No one who has the right should ask for it."""
    assert words in str(refused(403, message=message).hint)


def test_a_field_conflict_names_managers_and_fields() -> None:
    """As server-side apply tells them."""
    causes = [
        {
            "reason": "FieldManagerConflict",
            "message": 'conflict with "kubectl" using apps/v1',
            "field": ".spec.replicas",
        },
        {"reason": "Other", "message": "m", "field": "f"},
    ]
    error = refused(409, message="m", details={"causes": causes})
    assert isinstance(error, Conflict)
    assert error.fields == (FieldConflict("kubectl", ".spec.replicas"),)


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        (
            path("v1", Resource("pods", True), "ns", "p", "log", query={"follow": "true", "x": ""}),
            "/api/v1/namespaces/ns/pods/p/log?follow=true",
        ),
        (path("apps/v1", Resource("deployments", True)), "/apis/apps/v1/deployments"),
        (
            path("rbac.authorization.k8s.io/v1", Resource("clusterroles", False), "", "a:b/c"),
            "/apis/rbac.authorization.k8s.io/v1/clusterroles/a%3Ab%2Fc",
        ),
        (
            path("v1", Resource("pods", True), "n", "p", "exec", query={"command": ["a b", "c"]}),
            "/api/v1/namespaces/n/pods/p/exec?command=a+b&command=c",
        ),
    ],
)
def test_urls(url: str, expected: str) -> None:
    """Core and grouped kinds, namespaced and not, names with strange letters."""
    assert url == expected


def test_discovery_is_asked_only_for_what_the_table_lacks() -> None:
    """Built-in kinds cost no request; a kind that comes later is found later."""
    asked: list[str] = []
    served: list[dict[str, Any]] = []

    def fetch(version: str) -> dict[str, Any]:
        asked.append(version)
        return {"resources": served}

    resources = ApiResources(fetch)
    assert resources.find("apps/v1", "Deployment") == Resource("deployments", True)
    assert resources.find("v1", "Node") == Resource("nodes", False)
    assert asked == []
    assert resources.find("x/v1", "Robot") is None
    served += [
        {"name": "robots", "kind": "Robot", "namespaced": True},
        {"name": "robots/status", "kind": "Robot", "namespaced": False},
    ]
    assert resources.find("x/v1", "Robot") == Resource("robots", True)
    assert resources.find("x/v1", "Robot") == Resource("robots", True)
    assert asked == ["x/v1", "x/v1"]


@pytest.mark.programs
def test_naming_objects_costs_no_http() -> None:
    """Rooms that only build manifests do not pay for a client."""
    code = (
        "import sys; import rigel_k8s.release.types, rigel_k8s.kube;"
        " print([m for m in ('http.client', 'ssl', 'yaml', 'urllib3') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
