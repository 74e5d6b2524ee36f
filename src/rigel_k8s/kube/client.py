"""Requests and answers as JSON: what every call on a cluster has in common."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar
from urllib.parse import quote

from rigel_k8s.kube.answers import parse, read_kinds, read_object
from rigel_k8s.kube.connections import Stream
from rigel_k8s.kube.failures import Conflict, Garbled, Missing, garbled_error, refusal
from rigel_k8s.kube.resources import ApiResources, Resource, path
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.transport import Answer, Transport
from rigel_k8s.objects.refs import ObjectRef

T = TypeVar("T")


class Client:
    """Speaks JSON to one API server and wraps its refusals."""

    def __init__(self, target: Target):
        self.target = target
        self.transport = Transport(target)
        self.resources = ApiResources(self.fetch_kinds)

    def call(
        self,
        method: str,
        path: str,
        what: str,
        read: Callable[[Any], T],
        *,
        body: object = None,
        media: str = "application/json",
        accept: str = "application/json",
        safe: bool | None = None,
    ) -> T:
        """Send a request and return its JSON answer.

        An answer that is not valid counts as lost: the request is sent a second time if that is
        harmless.

        Args:
            read: checks the answer's shape; one of kube/answers.py.
            safe: as for `Transport.request`.

        Raises:
            ClusterError: the server refused (Missing, Conflict, Refusal), did not answer, or its
                answer is not valid (Garbled).
        """
        data = None if body is None else json.dumps(body, separators=(",", ":")).encode()
        again = method == "GET" if safe is None else safe
        doubtful = False
        while True:
            answer = self.transport.request(
                method,
                path,
                what,
                body=data,
                media=media if data else "",
                accept=accept,
                safe=safe,
                doubtful=doubtful,
            )
            self.raise_for(answer, what)
            try:
                return read(parse(answer.body))
            except ValueError as error:
                if doubtful or not again:
                    raise self.garbled_error(what, path, answer.body, str(error)) from error
            doubtful = True

    def write(
        self,
        method: str,
        url: str,
        what: str,
        body: Any,
        media: str = "application/json",
        *,
        safe: bool = True,
    ) -> dict[str, Any]:
        """Send a write, again if its answer is lost, and return the resulting object.

        A create or a conditional write that was carried out is refused the second time: an object
        that has all that we sent is our own. A dry run is never carried out.

        Raises: as `call`.
        """
        try:
            return self.call(method, url, what, read_object, body=body, media=media, safe=safe)
        except Conflict as error:
            if not error.doubtful or "dryRun=All" in url:
                raise
            place = url.partition("?")[0]
            if method == "POST":
                place += f"/{quote(body['metadata']['name'], safe='')}"
            live = self.call("GET", place, what, read_object)
            if not has_all(live, body):
                raise
            return live

    def stream(self, path: str, what: str, *, timeout: float | None = None) -> Stream:
        """Open a stream; raises like `call`."""
        opened = self.transport.stream(path, what, timeout=timeout)
        if isinstance(opened, Answer):
            self.raise_for(opened, what)
            raise AssertionError("an answer that is not a stream is an error")
        return opened

    def raise_for(self, answer: Answer, what: str) -> None:
        """Raise if the server refused."""
        if answer.status >= 400:
            context, server = self.target.context, self.target.server
            body = self.transport.conceal(answer.body)
            error = refusal(answer.status, body, what, context=context, server=server)
            error.doubtful = answer.doubtful
            raise error

    def garbled_error(self, what: str, path: str, body: bytes, reason: str) -> Garbled:
        """Return the error for an invalid answer, without our credentials."""
        url = self.target.server + path
        return garbled_error(what, url, self.transport.conceal(body), reason)

    def resource(self, api_version: str, kind: str, what: str) -> Resource:
        """Return the API's name for a kind.

        Raises:
            NotFoundError: the cluster does not have the kind.
        """
        if found := self.resources.find(api_version, kind):
            return found
        error = Missing(
            f"cannot {what}: the cluster has no kind {kind} of {api_version}",
            hint="first install what defines it (its CustomResourceDefinition)",
        )
        error.status, error.reason = 404, "NoKind"
        raise error

    def path_of(
        self,
        ref: ObjectRef,
        what: str,
        *,
        subresource: str = "",
        query: Mapping[str, object] | None = None,
    ) -> str:
        """Return the URL path of one object."""
        resource = self.resource(ref.api_version, ref.kind, what)
        return path(ref.api_version, resource, ref.namespace, ref.name, subresource, query=query)

    def fetch_kinds(self, api_version: str) -> Mapping[str, Any] | None:
        """Return the resource list of an API version, None if the server does not have it."""
        root = "api" if "/" not in api_version else "apis"
        try:
            url = f"/{root}/{quote(api_version)}"
            return self.call("GET", url, f"look up {api_version}", read_kinds)
        except Missing:
            return None


def has_all(live: Any, sent: Any) -> bool:
    """Whether an object has all that was sent of it, apart from the version of the condition."""
    if isinstance(sent, dict) and isinstance(live, dict):
        return all(
            has_all(live.get(key), value) for key, value in sent.items() if key != "resourceVersion"
        )
    if isinstance(sent, list) and isinstance(live, list):
        return len(sent) == len(live) and all(map(has_all, live, sent))
    return bool(live == sent)
