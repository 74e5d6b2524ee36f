"""The one object of the cluster that keeps the gate's memory, by the Kubernetes API.

The pod's service account may read and change this object only; `rigel` creates it, empty.
"""

from __future__ import annotations

import base64
import http.client
import json
import os
import ssl
from pathlib import Path
from typing import Any

ACCOUNT = Path("/var/run/secrets/kubernetes.io/serviceaccount")
#: The pod whose gate writes; another gate has to stop then.
WRITER = "rigel-k8s/gate"
KEY = "memory"
SECONDS = 10


class NotKept(Exception):
    """The object could not be read or written; the message is the cause."""


class Overtaken(NotKept):
    """The gate of another pod writes the object now."""


class ClusterObject:
    """A Secret of the pod's namespace.

    Args:
        name: the Secret's.
        pod: this pod's own name, kept with what it writes.
    """

    def __init__(self, name: str, pod: str, account: Path = ACCOUNT) -> None:
        namespace = (account / "namespace").read_text().strip()
        self._path = f"/api/v1/namespaces/{namespace}/secrets/{name}"
        self._pod = pod
        self._account = account
        self._version = ""

    def read(self, *, takes_over: bool) -> str | None:
        """Return what is kept, None if nothing is yet.

        Args:
            takes_over: from now on this pod writes, whichever did before.

        Raises:
            NotKept: it cannot be read.
        """
        found = self._ask("GET")
        kept = (found.get("data") or {}).get(KEY)
        if takes_over:
            self._version = found["metadata"]["resourceVersion"]
            self._write({"metadata": {"annotations": {WRITER: self._pod}}})
        return base64.b64decode(kept).decode("ascii") if kept else None

    def write(self, text: str) -> None:
        """Keep a text.

        Raises:
            Overtaken: another pod has begun to write.
            NotKept: it cannot be written.
        """
        data = base64.b64encode(text.encode("ascii")).decode("ascii")
        if not self._version:
            self._check_writer()
        self._write({"data": {KEY: data}})

    def _check_writer(self) -> None:
        """Learn the object's version; raises Overtaken."""
        found = self._ask("GET")
        writer = (found["metadata"].get("annotations") or {}).get(WRITER, self._pod)
        if writer != self._pod:
            raise Overtaken(f"the gate of pod {writer} writes now")
        self._version = found["metadata"]["resourceVersion"]

    def _write(self, change: dict[str, Any]) -> None:
        for _ in range(5):
            meta = {**change.get("metadata", {}), "resourceVersion": self._version}
            try:
                found = self._ask("PATCH", {**change, "metadata": meta})
                self._version = found["metadata"]["resourceVersion"]
                return
            except _Changed:
                if "metadata" in change:  # this pod takes over
                    self._version = self._ask("GET")["metadata"]["resourceVersion"]
                else:
                    self._check_writer()
        raise NotKept("another program keeps changing it")

    def _ask(self, method: str, body: Any = None) -> Any:
        host = os.environ.get("KUBERNETES_SERVICE_HOST", "")
        port = os.environ.get("KUBERNETES_SERVICE_PORT", "443")
        path = self._path + ("?fieldManager=rigel-gate" if method == "PATCH" else "")
        try:
            token = (self._account / "token").read_text().strip()
            connection = self._connect(host, int(port))
        except OSError as error:
            raise NotKept(f"the pod's service account cannot be read: {error}") from error
        head = {"Authorization": f"Bearer {token}", "Content-Type": "application/merge-patch+json"}
        try:
            connection.request(method, path, json.dumps(body) if body else None, head)
            answer = connection.getresponse()
            text = answer.read().decode("utf-8", "replace")
        except (OSError, http.client.HTTPException) as error:
            raise NotKept(f"cannot reach the API server at {host}:{port}: {error}") from error
        finally:
            connection.close()
        if answer.status == 409:
            raise _Changed(text)
        found = _read_object(text) if answer.status == 200 else None
        if found is None:
            raise NotKept(f"the API server answered {answer.status}: {text[:300]}")
        return found

    def _connect(self, host: str, port: int) -> http.client.HTTPConnection:
        context = ssl.create_default_context(cafile=str(self._account / "ca.crt"))
        context.verify_flags &= ~getattr(ssl, "VERIFY_X509_STRICT", 0)  # as kubectl does
        return http.client.HTTPSConnection(host, port, timeout=SECONDS, context=context)


def _read_object(text: str) -> Any:
    try:
        found = json.loads(text)
        return found if found["metadata"]["resourceVersion"] else None
    except (ValueError, LookupError, TypeError):
        return None  # perhaps the answer of a proxy


class _Changed(NotKept):
    """The object has changed since it was read."""
