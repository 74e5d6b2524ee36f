"""The request to `up`, checked before anything is started.

It compares a request with an existing cluster; it starts nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import attrs

from rigel_k8s.errors import UserError
from rigel_lab.cluster.addons import EXTRAS
from rigel_lab.cluster.state import State

DEFAULT_NODES = 2
MOST_NODES = 50


@attrs.frozen
class Wish:
    """The request to `up`; None: as the existing cluster, else the default.

    Attributes:
        nodes: how many.
        extras: what the registry offers in addition; a running cluster gains them.
        data_dir: k3s' data directory, if nodes are laid out as those of k3s.
    """

    nodes: int | None = None
    extras: Sequence[str] = ()
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

    def complete_from(self, state: State) -> Wish:
        """Return a request for a cluster like an earlier one, apart from what is requested."""
        extras = sorted({*self.extras, *state.extras})
        return Wish(self.nodes or state.nodes, extras, self.data_dir or state.data_dir)

    def compare(self, state: State) -> None:
        """Refuse to change what is fixed for a cluster's life.

        Raises:
            UserError: it has another number of nodes or other places.
        """
        hint = f"rigel cluster down --name {state.name}, then up again"
        if self.nodes not in (None, state.nodes):
            raise UserError(
                f"cluster {state.name} has {state.nodes} nodes, not {self.nodes}", hint=hint
            )
        if self.data_dir not in (None, state.data_dir):
            raise UserError(
                f"cluster {state.name} was not made with --k3s {self.data_dir}", hint=hint
            )
