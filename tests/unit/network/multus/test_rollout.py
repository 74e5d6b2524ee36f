"""The roll-out of Multus, killed after any of its writes and run again."""

from __future__ import annotations

from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.desired import Installation
from rigel_k8s.network.multus.install import MultusPart, find_release
from rigel_k8s.network.multus.installation import Found
from rigel_k8s.network.multus.platform import platform
from rigel_k8s.network.multus.recognition import Group
from rigel_k8s.network.multus.rollout import Rollout
from rigel_k8s.network.options import Install
from rigel_k8s.release import revisions
from rigel_k8s.release.lease import PROCESS, lease_ref, process
from rigel_k8s.release.types import DeployOptions
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Killed, Store
from tests.support.recorder import Recorder

LEASE = lease_ref(RELEASE)
GROUP = Group(platform("plain"), ())


def roll_out(fake: FakeCluster) -> None:
    """Install on a cluster whose machines are all still to come."""
    found = Found((), (GROUP,), None, None, frozenset())
    asked = Installation([GROUP], whereabouts=False)
    part = MultusPart(
        desired=find_release(None, asked, found),
        options=Install(),
        installation=asked,
        found=found,
        unproven=frozenset(),
    )
    options = DeployOptions(report=Recorder(), timeout=5)
    part.install(fake, part.look(fake, adopt=False), options)
    Rollout(fake, asked, found, options).wait()


def test_a_killed_installation_is_completed_by_the_next() -> None:
    """No Lease stays, and the last revision is good."""
    kills = 0
    for limit in range(1, 60):
        fake = FakeCluster(Store(controllers=Controllers()))
        meta = {"name": RELEASE.namespace}
        fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
        fake.store.die_after = limit
        try:
            roll_out(fake)
        except Killed:
            kills += 1
            fake.revive()
            if LEASE in fake.objects:
                boot, space, pid, _ = process().split()
                dead = {PROCESS: f"{boot} {space} {pid} 0"}
                fake.objects[LEASE]["metadata"]["annotations"] = dead
            roll_out(fake)
            assert LEASE not in fake.objects
            assert revisions.records(fake, RELEASE)[-1].status == "good"
        else:
            break
    assert kills > 10
