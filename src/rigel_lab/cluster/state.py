"""The stored state of a cluster between two commands: one JSON file."""

from __future__ import annotations

import json
from pathlib import Path

import attrs

from rigel_k8s.errors import UserError
from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import CONTROL_PLANE, Layout, NodePaths, k3s_paths, plain_paths
from rigel_lab.cluster.machine import Process, read_process
from rigel_lab.cluster.paths import directory_of, names


@attrs.define
class State:
    """The stored state of a cluster.

    Attributes:
        block: its address ranges.
        boot: the boot of this machine in which it was made.
        components: the programs it was made with; a newer rigel does not mix versions.
        kubeconfigs: each file that has its context -> the context that was current there before.
        furnished: whether everything of a new cluster is in it.
        extras: what was requested in addition (`--with`).
        offers: the images that its registry has for it, as nodes name them.
        data_dir: of nodes laid out as k3s does; None where they are plain.
    """

    name: str
    nodes: int
    block: str
    boot: str
    kubernetes: str
    components: Components
    kubeconfigs: dict[str, str | None] = attrs.field(factory=dict)
    furnished: bool = False
    extras: list[str] = attrs.field(factory=list)
    offers: list[str] = attrs.field(factory=list)
    data_dir: str | None = None

    @property
    def directory(self) -> Path:
        """The cluster's directory."""
        return directory_of(self.name)

    @property
    def context(self) -> str:
        """The cluster's context in a kubeconfig."""
        return f"rigel-{self.name}"

    @property
    def node_names(self) -> list[str]:
        return [f"node{index}" for index in range(1, self.nodes + 1)]

    @property
    def machine_names(self) -> list[str]:
        """All machines, the control plane first."""
        return [CONTROL_PLANE, *self.node_names]

    @property
    def layout(self) -> Layout:
        """What its machines share."""
        return Layout(
            self.name, self.directory, Addresses(self.block), self.components, self.node_paths
        )

    @property
    def node_paths(self) -> NodePaths:
        """Where its nodes have what other programs look for."""
        return k3s_paths(self.data_dir) if self.data_dir else plain_paths()

    def process(self, machine: str) -> Process | None:
        """Return a machine's process if it still runs."""
        process = read_process(self.directory / machine)
        return process if process and process.alive else None

    def save(self) -> None:
        """Write it, all or nothing."""
        self.directory.mkdir(parents=True, exist_ok=True)
        path = self.directory / "cluster.json"
        new = path.with_suffix(".new")
        new.write_text(json.dumps(attrs.asdict(self), indent=2))
        new.replace(path)

    @classmethod
    def load(cls, name: str) -> State | None:
        """Return the stored state of a cluster, None if it has none."""
        path = directory_of(name) / "cluster.json"
        if not path.exists():
            return None
        content = json.loads(path.read_text())
        content["components"] = Components(**content["components"])
        return cls(**content)


def find(name: str) -> State:
    """Return an existing cluster.

    Raises:
        UserError: no cluster has that name.
    """
    if state := State.load(name):
        return state
    known = names()
    others = f"; there is {', '.join(known)}" if known else ""
    hint = f"--name {known[0]} for that one, or " if known else ""
    raise UserError(
        f"there is no local cluster {name}{others}", hint=f"{hint}rigel cluster up --name {name}"
    )
