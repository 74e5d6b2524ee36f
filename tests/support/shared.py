"""What the processes of one test run share: a directory, a kubeconfig, one local cluster.

The process that the user starts makes the directory; those that xdist starts find it by
RIGEL_TEST_RUN. What is done once is done under a lock in there.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO

from rigel_k8s.kube import connect
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from rigel_k8s.system.cache import cache_dir, locked

#: The local cluster of the tests.
NAME = "test"
#: A file with the namespace of the observability stack, where it is one of this run.
STACK = "stack"
RUN = "RIGEL_TEST_RUN"
ALONE = "RIGEL_TEST_ALONE"
#: Seconds: what a cluster is made of may have to be built.
BUILDS = 3600

_held: list[IO[str]] = []


def begin(*, clusters: bool) -> None:
    """Make the run's directory, in the process that the user started.

    The tests have a kubeconfig of their own in it, as `cluster up` changes the current context.
    Of two runs on one machine that may use clusters the first has the cluster.
    """
    os.environ[ALONE] = str(int(clusters and lock()))
    os.environ[RUN] = tempfile.mkdtemp(prefix="rigel-test-")
    if not os.environ.get("RIGEL_TEST_CONTEXT"):
        os.environ["KUBECONFIG"] = str(directory() / "kubeconfig")


def lock() -> bool:
    """Hold a lock file as long as this process lives; return whether no other run has it."""
    file = cache_dir() / "tests.lock"
    file.parent.mkdir(parents=True, exist_ok=True)
    _held.append(file.open("w"))
    try:
        fcntl.flock(_held[-1].fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def end() -> None:
    """End the clusters, unless RIGEL_TEST_KEEP=1, and remove the run's directory.

    The observability stack goes from a cluster that stays.
    """
    context, stack = os.environ.get("RIGEL_TEST_CONTEXT"), directory() / STACK
    if context and stack.exists():
        namespace = stack.read_text()
        words = ["observe", "remove", "--volumes", "-y"]
        run("--context", context, "-n", namespace, *words, check=False)
        with connect(Settings(context=context)) as cluster:
            cluster.delete(ObjectRef("v1", "Namespace", "", namespace))
    for cluster in directory().glob("*.cluster"):
        if os.environ.get("RIGEL_TEST_KEEP") != "1":
            run("cluster", "down", "--name", cluster.stem)
    shutil.rmtree(directory())
    while _held:
        _held.pop().close()


def mine(name: str) -> str:
    """Return the name of a cluster, which the run's end will take away if its test did not."""
    (directory() / f"{name}.cluster").touch()
    return name


def directory() -> Path:
    """Return the directory that the processes share."""
    return Path(os.environ[RUN])


def once(name: str, do: Callable[[], object]) -> None:
    """Do something once in a run, whichever process comes first; the others wait."""
    with locked(directory() / f"{name}.lock"):
        if not (directory() / name).exists():
            do()
            (directory() / name).touch()


def end_lane(lane: str) -> None:
    """Let the lanes that come after this one begin."""
    (directory() / f"{lane}.over").touch()


def wait_for_lane(lane: str) -> None:
    """Wait until another lane is over; the test's own timeout is the limit."""
    while not (directory() / f"{lane}.over").exists():
        time.sleep(0.5)


def possible() -> bool:
    """Return whether a local cluster is the tests' own affair, and can be started."""
    return os.geteuid() == 0 and not os.environ.get("RIGEL_TEST_CONTEXT")


def start_cluster() -> None:
    """Start the local cluster, or wait until another process has."""
    once(NAME, bring_up)


def bring_up() -> None:
    """Run `rigel cluster up`, after `down` where it is one of another shape.

    What tests of a run that was killed have left on it is deleted. The environment is that of the
    beginning: meanwhile a test beside this thread may change it for itself.

    Raises:
        AssertionError: another run uses it.
    """
    assert os.environ[ALONE] == "1", "another test run on this machine uses the cluster `test`"
    environ = dict(os.environ)
    words = ["cluster", "up", "--name", mine(NAME), "--nodes", "3"]
    words += ["--with", "multus", "--with", "kubectl"]
    if run(*words, check=False, env=environ) == 2:
        run("cluster", "down", "--name", NAME, env=environ)
        run(*words, env=environ)
    kubeconfig = Path(environ["KUBECONFIG"])
    with connect(Settings(context=f"rigel-{NAME}", kubeconfig=kubeconfig)) as cluster:
        for space in cluster.list("v1", "Namespace"):
            if (name := space["metadata"]["name"]).startswith("t-"):
                cluster.delete(ObjectRef("v1", "Namespace", "", name))


def run(*words: str, check: bool = True, env: Mapping[str, str] | None = None) -> int:
    """Run the command line and return its exit code; a failure shows its output."""
    done = subprocess.run(
        [sys.executable, "-m", "rigel_k8s", *words],
        env=env,
        check=False,
        capture_output=True,
        text=True,
        timeout=BUILDS,
    )
    if check and done.returncode != 0:
        raise AssertionError(f"rigel {' '.join(words)}\n{done.stdout}\n{done.stderr}")
    return done.returncode
