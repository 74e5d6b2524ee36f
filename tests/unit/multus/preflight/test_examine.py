"""How preflight ends: what is said, and with which exit code."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.network.options import Network, network_of
from rigel_multus.preflight.checks import MTU, MULTUS_MISSING
from rigel_multus.preflight.examine import examine, failure

LACKS = MULTUS_MISSING.problem("Multus is not installed", "install it")
WRONG = MTU.problem("an MTU of 9000 does not fit", "a smaller one")


class NoCluster:
    """Whoever asks it anything fails the test."""

    def __getattr__(self, name: str) -> Any:
        pytest.fail(f"the cluster was asked: {name}")


@pytest.mark.parametrize(
    "network",
    [None, "none", "peers", "discovery-server", "zenoh", Network(mode="peers")],
)
def test_nothing_is_asked_without_need(network: Network | str | None) -> None:
    """A release without a network of its own, or over the pod network, costs no request."""
    pods = {"template": {"spec": {"hostNetwork": True}}}
    objects = [{"kind": "Deployment", "metadata": {"name": "talker"}, "spec": pods}]
    assert examine(objects, network_of(network), NoCluster()) == []  # type: ignore[arg-type]


def test_nothing_is_asked_where_no_pod_wants_it() -> None:
    """A network key that no pod uses costs no request either."""
    assert examine([], Network(mode="macvlan"), NoCluster()) == []  # type: ignore[arg-type]


def test_nothing_found_is_no_failure() -> None:
    """Without errors there is nothing to raise."""
    assert failure([]) is None


def test_one_finding_is_the_error() -> None:
    """One thing that the cluster lacks: exit code 1, and its remedy is the hint."""
    error = failure([LACKS])
    assert type(error) is ClusterError
    assert (error.exit_code, error.message) == (1, "Multus is not installed [multus-missing]")
    assert error.hint == "install it"


def test_several_findings_are_one_error() -> None:
    """All at once, each with its remedy; exit code 2 as soon as one is the Rigelfile's."""
    error = failure([LACKS, WRONG])
    assert type(error) is UserError
    assert error.exit_code == 2
    assert error.message == "2 things keep the network of this release from working"
    assert error.details == (
        "Multus is not installed [multus-missing]",
        "    install it",
        "an MTU of 9000 does not fit [mtu]",
        "    a smaller one",
    )
