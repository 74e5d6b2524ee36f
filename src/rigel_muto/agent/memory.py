"""Where the agent keeps its record: a Secret, since stacks may have secrets in their environment.

It is written before a command is acknowledged, and belongs to no release: `down` leaves it.
"""

from __future__ import annotations

from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Missing
from rigel_k8s.release.survey import describe_namespace
from rigel_k8s.release.types import ReleaseId
from rigel_muto.agent.wanted import Record, decode, encode

KEY = "record"
TYPE = "rigel-k8s/muto-agent.v1"


class Memory:
    """The record of the agent of one release.

    Args:
        create_namespace: create the release's namespace where it is missing, as a deploy does.
    """

    def __init__(
        self, cluster: Cluster, release: ReleaseId, *, create_namespace: bool = False
    ) -> None:
        self._cluster = cluster
        self._create_namespace = create_namespace
        self.ref = ObjectRef("v1", "Secret", release.namespace, f"rigel.{release.name}.muto-agent")

    def load(self) -> Record:
        """Return what was stored last; an empty record if nothing was."""
        live = self._cluster.get(self.ref)
        return decode((live.get("data") or {}).get(KEY, "")) if live else Record()

    def store(self, record: Record) -> None:
        """Store a record; when this returns, it survives the end of this process."""
        meta = {"name": self.ref.name, "namespace": self.ref.namespace}
        secret = {
            "apiVersion": "v1",
            "kind": "Secret",
            "type": TYPE,
            "metadata": meta,
            "data": {KEY: encode(record)},
        }
        try:
            self._cluster.apply(secret)
        except Missing:
            if not self._create_namespace:
                raise
            self._cluster.apply(describe_namespace(self.ref.namespace))
            self._cluster.apply(secret)
