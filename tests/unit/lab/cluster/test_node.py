"""What nodes are told of the machine they are on."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import Layout
from rigel_lab.cluster.node import resolv_conf, setup


def test_name_servers_on_loopback_are_left_out(tmp_path: Path) -> None:
    """systemd-resolved's 127.0.0.53 is nobody in a network namespace; its own servers are."""
    stub, real = tmp_path / "stub", tmp_path / "real"
    stub.write_text("nameserver 127.0.0.53\noptions edns0\n")
    real.write_text("# comment\nnameserver 192.0.2.53\nnameserver ::1\nsearch lab\n")
    assert resolv_conf((real, stub)) == "nameserver 192.0.2.53\n"
    assert resolv_conf((tmp_path / "none", stub, real)) == "nameserver 192.0.2.53\n"
    assert resolv_conf((stub,)) == ""


@pytest.fixture
def layout(tmp_path: Path) -> Layout:
    programs = Components({"containerd": "/cache/go/containerd"}, "/cache/debian")
    return Layout("a", tmp_path, Addresses("10.64.0.0/14"), programs)


def test_only_what_leaves_the_cluster_is_masqueraded(layout: Layout) -> None:
    """Nodes and pods of other nodes see a pod's own address."""
    rules = [line for line in setup(layout, layout.directory / "node1") if "MASQUERADE" in line]
    assert rules == [
        "iptables -w -t nat -A POSTROUTING -s 10.64.0.0/14 ! -d 10.64.0.0/14 -j MASQUERADE"
    ]


def test_machines_have_nothing_of_the_users_environment(layout: Layout) -> None:
    """Programs get a PATH of their own; what a shell has exported does not reach containers."""
    found = layout.environment({"PATH": "/home/x/bin", "SECRET": "s", "PYTHONPATH": "p"})
    assert set(found) == {"PATH", "HOME", "LANG"}
    assert found["PATH"].startswith("/cache/go:/cache/debian/usr/bin:")


def test_proxies_are_passed_on_but_not_for_the_cluster(layout: Layout) -> None:
    """Behind a proxy images are pulled through it; the cluster itself is reached directly."""
    found = layout.environment({"https_proxy": "http://p:3128", "NO_PROXY": "corp.example"})
    assert found["https_proxy"] == "http://p:3128"
    assert "10.64.0.0/14" in found["NO_PROXY"].split(",")
    assert "corp.example" in found["NO_PROXY"].split(",")
