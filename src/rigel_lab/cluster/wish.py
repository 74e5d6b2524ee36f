"""The request to `up`, checked before anything is started.

It compares a request with an existing cluster; it starts nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs

from rigel_k8s.errors import UserError
from rigel_lab.cluster.extras import EXTRAS
from rigel_lab.cluster.nodepaths import K3S_DATA, check_data_dir, describe
from rigel_lab.cluster.state import State

DEFAULT_NODES = 2
MOST_NODES = 50
LAYOUTS = ("plain", "k3s")


@attrs.frozen
class Wish:
    """The request to `up`; None: as the existing cluster, else the default.

    Attributes:
        nodes: how many.
        extras: what the registry offers in addition; a running cluster gains them.
        layout: where nodes have what other programs look for, one of LAYOUTS.
        data_dir: k3s' data directory.
    """

    nodes: int | None = None
    extras: Sequence[str] = ()
    layout: str | None = None
    data_dir: str | None = None

    def check(self) -> None:
        """Refuse what no cluster can be.

        Raises:
            UserError: with what is possible.
        """
        if self.nodes is not None and not 1 <= self.nodes <= MOST_NODES:
            raise UserError(
                f"a cluster of {self.nodes} nodes", hint=f"1 to {MOST_NODES} are possible"
            )
        if unknown := sorted(set(self.extras) - set(EXTRAS)):
            raise UserError(
                f"unknown extra {', '.join(unknown)}",
                hint=f"choose from {', '.join(EXTRAS)}",
            )
        if self.layout not in (None, *LAYOUTS):
            raise UserError(
                f"unknown layout {self.layout}", hint=f"choose from {', '.join(LAYOUTS)}"
            )
        self.check_data_dir()

    def check_data_dir(self) -> None:
        """Refuse an impossible data directory, or one without the layout that has it."""
        if self.data_dir is None:
            return
        if self.layout != "k3s":
            raise UserError("only nodes of k3s have a data directory", hint="add --layout k3s")
        check_data_dir(self.data_dir)

    @property
    def new_data_dir(self) -> str | None:
        """The data directory of a cluster that is made now."""
        return (self.data_dir or K3S_DATA) if self.layout == "k3s" else None

    @property
    def builds(self) -> list[str]:
        """What to build in addition to what every cluster needs."""
        return [*self.extras, *(["k3s"] if self.layout == "k3s" else [])]

    def complete_from(self, state: State) -> Wish:
        """Return a request for a cluster like an earlier one, apart from what is requested."""
        layout = ("k3s", state.data_dir) if state.data_dir else (None, None)
        return Wish(
            self.nodes or state.nodes,
            sorted({*self.extras, *state.extras}),
            *((self.layout, self.data_dir) if self.layout else layout),
        )

    def compare(self, state: State) -> None:
        """Refuse to change what is fixed for a cluster's life.

        Raises:
            UserError: it has another number of nodes or another layout.
        """
        hint = f"rigel cluster down --name {state.name}, then up again"
        if self.nodes not in (None, state.nodes):
            raise UserError(
                f"cluster {state.name} has {state.nodes} nodes, not {self.nodes}", hint=hint
            )
        if self.layout is not None and self.new_data_dir != state.data_dir:
            raise UserError(
                f"the nodes of cluster {state.name} are laid out as {describe(state.data_dir)},"
                f" not {describe(self.new_data_dir)}",
                hint=hint,
            )
