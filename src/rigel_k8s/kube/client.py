"""Requests and answers as JSON: what every call on a cluster has in common."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from rigel_k8s.kube.failures import Missing, refusal
from rigel_k8s.kube.resources import ApiResources, Resource
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.transport import Answer, Stream, Transport


class Client:
    """Speaks JSON to one API server and wraps what it refuses."""

    def __init__(self, target: Target):
        self.target = target
        self.transport = Transport(target)
        self.resources = ApiResources(self.fetch_kinds)

    def call(
        self,
        method: str,
        path: str,
        what: str,
        *,
        body: object = None,
        media: str = "application/json",
        accept: str = "application/json",
        safe: bool | None = None,
    ) -> dict[str, Any]:
        """Send a request and return its JSON answer.

        Raises:
            ClusterError: the server refused (Missing, Conflict, Refusal) or did not answer.
        """
        data = None if body is None else json.dumps(body, separators=(",", ":")).encode()
        answer = self.transport.request(
            method, path, what, body=data, media=media if data else "", accept=accept, safe=safe
        )
        self.raise_for(answer, what)
        content: dict[str, Any] = json.loads(answer.body)
        return content

    def stream(self, path: str, what: str, *, timeout: float | None = None) -> Stream:
        """Open a stream; raises like `call`."""
        opened = self.transport.stream(path, what, timeout=timeout)
        if isinstance(opened, Answer):
            self.raise_for(opened, what)
            raise AssertionError("an answer that is no stream is an error")
        return opened

    def raise_for(self, answer: Answer, what: str) -> None:
        """Raise where the server refused."""
        if answer.status >= 400:
            context, server = self.target.context, self.target.server
            raise refusal(answer.status, answer.body, what, context=context, server=server)

    def resource(self, api_version: str, kind: str, what: str) -> Resource:
        """Return how the API calls a kind.

        Raises:
            NotFoundError: the cluster has no such kind.
        """
        if found := self.resources.find(api_version, kind):
            return found
        error = Missing(
            f"cannot {what}: the cluster has no kind {kind} of {api_version}",
            hint="install what brings it (its CustomResourceDefinition) first",
        )
        error.status, error.reason = 404, "NoKind"
        raise error

    def fetch_kinds(self, api_version: str) -> Mapping[str, Any] | None:
        """Return the resource list of an API version, None where the server has none."""
        root = "api" if "/" not in api_version else "apis"
        try:
            return self.call("GET", f"/{root}/{quote(api_version)}", f"look up {api_version}")
        except Missing:
            return None
