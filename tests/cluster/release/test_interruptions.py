"""A deploy that dies anywhere orphans nothing, and two deploys of one release never mix."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.release.locking import hold
from rigel_k8s.release.revisions import history
from rigel_k8s.release.types import DeployOptions
from tests.support.releases import deploy, down

pytestmark = pytest.mark.cluster

#: Deploys what a pickle says, and kills itself right after its n-th write.
DYING = textwrap.dedent(
    """
    import os, pickle, signal, sys, threading
    from tests.support.releases import deploy
    from rigel_k8s.kube import connect
    from rigel_k8s.settings import Settings

    context, path, limit = sys.argv[1], sys.argv[2], int(sys.argv[3])
    cluster = connect(Settings(context=context))
    call, lock, writes = cluster.client.call, threading.Lock(), 0

    def counted(method, url, *args, **more):
        global writes
        if method == "GET" or "dryRun" in url:
            return call(method, url, *args, **more)
        with lock:
            answer = call(method, url, *args, **more)
            writes += 1
            if writes == limit:
                os.kill(os.getpid(), signal.SIGKILL)
        return answer

    cluster.client.call = counted

    class Silent:
        def line(self, text): pass
        def warn(self, text): pass
        def progress(self, key, state, *, done=False): pass

    with open(path, "rb") as file:
        deploy(pickle.load(file), cluster, report=Silent())
    """
)


def die(context: str, wanted: Any, tmp_path: Path, limit: int) -> int:
    """Deploy in a process that dies after its n-th write; return its exit code."""
    import pickle

    path = tmp_path / "desired.pickle"
    path.write_bytes(pickle.dumps(wanted))
    words = [sys.executable, "-c", DYING, context, str(path), str(limit)]
    return subprocess.run(words, check=False, timeout=300).returncode


def there(cluster: Any, make: Any) -> set[tuple[str, str]]:
    """Return all that is there of the release, its own records included."""
    kinds = [("v1", "ConfigMap"), ("apps/v1", "Deployment"), ("v1", "Secret")]
    kinds.append(("coordination.k8s.io/v1", "Lease"))
    return {
        (kind, live["metadata"]["name"])
        for version, kind in kinds
        for live in cluster.list(version, kind, make.namespace)
        if live["metadata"]["name"] != "kube-root-ca.crt"
    }


@pytest.mark.parametrize("then", ["deploy", "down"])
def test_a_kill_after_any_write_orphans_nothing(
    cluster: Any, admin: Any, make: Any, report: Any, context: str, tmp_path: Path, then: str
) -> None:
    """After a kill -9 at each write in turn, the next deploy or down leaves just what it shall."""
    old = make.desired(make.config("a", k="1"), make.config("b"), make.deployment("x", replicas=0))
    new = make.desired(make.config("a", k="2"), make.config("c"), make.deployment("y", replicas=0))
    third = make.desired(make.config("d"))
    killed = 0
    for limit in range(1, 30):
        deploy(old, cluster, report=report)
        code = die(context, new, tmp_path, limit)
        if code == 0:
            break
        killed += 1
        assert code == -9
        if then == "down":
            down(cluster, make.release, volumes=True, report=report)
            assert there(admin, make) == set(), f"killed after write {limit}"
        else:
            deploy(third, cluster, report=report)
            left = {found for found in there(admin, make) if found[0] != "Secret"}
            assert left == {("ConfigMap", "d")}, f"killed after write {limit}"
            assert "pending" not in {r.status for r in history(cluster, make.release)}
    assert killed >= 8, "Lease, revision, three objects, two prunes, the revision again"


def test_a_second_deploy_is_told_who_holds_the_release(
    cluster: Any, make: Any, report: Any
) -> None:
    """While one deploy is under way another one writes nothing."""
    deploy(make.desired(make.config(a="1")), cluster, report=report)
    wanted = make.desired(make.config(a="2"))
    with (
        hold(cluster, make.release, DeployOptions(report=report, lock_timeout=0)),
        pytest.raises(ClusterError, match=f"process {os.getpid()}") as caught,
    ):
        deploy(wanted, cluster, report=report, lock_timeout=0)
    assert "is being changed by" in caught.value.message
    assert len(history(cluster, make.release)) == 1
    deploy(wanted, cluster, report=report)
