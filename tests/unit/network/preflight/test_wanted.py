"""Which pods ask for a second network."""

from __future__ import annotations

from ipaddress import ip_address

import pytest

from rigel_k8s.network.preflight.wanted import Request, find_wanted, requests

from .cases import workload


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lan", [Request("robot/lan")]),
        ("lan, lab/other@net2", [Request("robot/lan"), Request("lab/other")]),
        ('[{"name": "lan"}]', [Request("robot/lan")]),
        (
            '[{"name": "x", "namespace": "lab", "ips": ["10.1.0.5/24", "none"]}]',
            [Request("lab/x", (ip_address("10.1.0.5"),))],
        ),
        ("[broken", []),
        ("", []),
    ],
)
def test_what_a_pod_asks_for(text: str, expected: list[Request]) -> None:
    """Both forms of Multus' annotation; one that makes no sense asks for nothing."""
    assert list(requests({"k8s.v1.cni.cncf.io/networks": text}, "robot")) == expected


def test_who_is_wired() -> None:
    """Workloads with an attachment or on the machine's network; no replicas said is one."""
    none = workload("plain", networks=None)
    off = workload("off", replicas=0)
    found = list(
        find_wanted([none, off, workload("one"), workload("host", None, hostNetwork=True)])
    )
    assert [(w.workload, w.pods) for w in found] == [("off", 0), ("one", 1), ("host", 1)]
