"""interface.sh, run by a real shell in network namespaces of its own."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from rigel_k8s.network.files import SCRIPT, interface_script

#: net1 and another interface, whose addresses differ late, and a route through one to everywhere.
SETUP = """\
set -e
mount -t tmpfs tmpfs "$TARGET"
ip link set lo up
for name in eth0 net1; do
  ip link add $name type bridge
  ip link set $name up
done
ip addr add 10.20.4.9/22 dev eth0
ip addr add 10.20.0.9/22 dev net1
ip addr add 10.20.9.1/24 dev eth0
ip route add default dev eth0
code=0
{shell} "$SOURCE/interface.sh" {words} >"$OUT" 2>&1 || code=$?
cp -r "$TARGET/." "$MADE"
exit $code
"""
NAMESPACES = ["unshare", "--net", "--mount"]


def possible() -> bool:
    """Return whether this machine lets us make a network namespace with an interface."""
    if not shutil.which("unshare") or not shutil.which("ip"):
        return False
    line = [*NAMESPACES, "sh", "-c", "mount -t tmpfs tmpfs /mnt && ip link add x type bridge"]
    return subprocess.run(line, capture_output=True, check=False).returncode == 0


pytestmark = [
    pytest.mark.skipif(not possible(), reason="wants root and network namespaces"),
    pytest.mark.programs,
]

SHELLS = [name for name in ("dash", "bash", "busybox") if shutil.which(name)]


@pytest.fixture(params=SHELLS)
def shell(request: pytest.FixtureRequest) -> str:
    """A shell as an image may have it."""
    name: str = request.param
    return "busybox sh" if name == "busybox" else name


class Pod:
    """A pod's directories; what the script writes is seen in `made`."""

    def __init__(self, tmp_path: Path) -> None:
        self.source, self.target = tmp_path / "source", tmp_path / "target"
        self.made, self.out = tmp_path / "made", tmp_path / "out"
        for directory in (self.source, self.target, self.made):
            directory.mkdir()
        text = interface_script().replace("/rigel-k8s-network", str(self.target))
        (self.source / SCRIPT).write_text(text)

    def run(self, shell: str, words: str) -> int:
        """Return the script's exit code."""
        places = {"SOURCE": self.source, "TARGET": self.target, "MADE": self.made, "OUT": self.out}
        env = {name: str(path) for name, path in places.items()}
        return subprocess.run(
            [*NAMESPACES, "sh", "-c", SETUP.format(shell=shell, words=words)],
            env=env | {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"},
            check=False,
        ).returncode


@pytest.fixture
def pod(tmp_path: Path) -> Pod:
    return Pod(tmp_path)


def test_the_address_is_that_of_the_interface(pod: Pod, shell: str) -> None:
    """Two interfaces, a default route through one of them: each has its own address, by /proc."""
    (pod.source / "a.xml").write_text("<a>\n  <b x='\\n %s'>@ADDRESS@</b>\n</a>\n")
    assert pod.run(shell, "net1 gone") == 0
    assert pod.out.read_text() == "net1 has the address 10.20.0.9\n"
    made = (pod.made / "a.xml").read_text()
    assert made == "<a>\n  <b x='\\n %s'>10.20.0.9</b>\n</a>\n"
    assert pod.run(shell, "eth0 gone") == 0
    assert pod.out.read_text() == "eth0 has the address 10.20.4.9\n"


def test_a_missing_interface_ends_the_start_with_one_line(pod: Pod, shell: str) -> None:
    """What is said is what the caller gave, and nothing is written."""
    (pod.source / "a.xml").write_text("@ADDRESS@\n")
    assert pod.run(shell, "net2 'net2 is missing: nobody attached it'") == 1
    assert pod.out.read_text() == "net2 is missing: nobody attached it\n"
    assert not (pod.made / "a.xml").exists()


def test_an_interface_whose_name_begins_alike_is_another(pod: Pod, shell: str) -> None:
    """`net` is not net1, and `net1` not `net10`."""
    assert pod.run(shell, "net gone") == 1
    assert pod.run(shell, "net10 gone") == 1


def test_an_interface_without_an_address_is_told(pod: Pod, shell: str) -> None:
    """lo has an address that leads nowhere: it is no answer."""
    assert pod.run(shell, "lo gone") == 1
    assert pod.out.read_text() == "lo has no IPv4 address: it got none from the network\n"


def test_a_known_address_is_not_looked_for(pod: Pod, shell: str) -> None:
    """With `ipam: static` the address is what was given out."""
    (pod.source / "a.xml").write_text("@ADDRESS@\n")
    assert pod.run(shell, "net1 gone 10.20.0.77") == 0
    assert (pod.made / "a.xml").read_text() == "10.20.0.77\n"


def test_each_pod_has_an_identity_of_its_own(pod: Pod, shell: str) -> None:
    """A machine-id is 32 hexadecimal digits, and another each time."""
    found = set()
    for _ in range(2):
        assert pod.run(shell, "net1 gone") == 0
        found.add((pod.made / "machine-id").read_text())
    assert len(found) == 2
    assert all(re.fullmatch(r"[0-9a-f]{32}\n", text) for text in found)
