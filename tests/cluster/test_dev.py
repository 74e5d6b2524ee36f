"""`rigel dev` on a real cluster: changed files run in the same pod; afterwards all is as before."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef

from ..support.relay import Relay, relaying
from ..support.until import until
from .background import Background
from .conftest import Rigel, pod_uids, write_idle

pytestmark = pytest.mark.cluster

#: Prints a file's content at its start, and the pod's own text without one.
PROGRAM = 'echo "runs $(cat /app/text || echo release)"; while :; do sleep 1; done'


class World:
    """A release of two nodes, and `rigel dev` for one of them."""

    def __init__(self, cluster: Any, namespace: str, place: list[str], folder: Path) -> None:
        self.cluster, self.namespace, self.place, self.folder = cluster, namespace, place, folder
        self.source = folder / "src"
        self.source.mkdir()

    def start(self) -> Background:
        """Start `rigel dev motor`, and wait until the first copy runs."""
        self.save("one")
        words = ["-f", str(self.folder / "Rigelfile"), *self.place, "dev", "motor"]
        sync = ["--sync", f"{self.source}:/app"]
        running = Background([sys.executable, "-m", "rigel_k8s", *words, *sync])
        self.expect(running, "runs one")
        return running

    def save(self, text: str) -> None:
        """Write the file that the program prints."""
        (self.source / "text").write_text(text)

    def expect(self, running: Background, pattern: str) -> None:
        """Wait for a line."""
        until(lambda: running.found(pattern), pattern, 240, last_words=lambda: running.lines)

    def pods(self) -> dict[str, str]:
        """Return the UIDs of the pods, by the names of their nodes."""
        return pod_uids(self.cluster, self.namespace)

    def deployment(self) -> dict[str, Any]:
        """Return the node's Deployment without what Kubernetes counts in it."""
        live = self.cluster.get(ObjectRef("apps/v1", "Deployment", self.namespace, "motor"))
        notes = dict(live["metadata"]["annotations"])
        notes.pop("deployment.kubernetes.io/revision")
        return {"spec": live["spec"], "annotations": notes, "labels": live["metadata"]["labels"]}

    def status(self, rigel: Rigel) -> str:
        """Return what `rigel status` shows, also while a pod is not ready."""
        return rigel("status", cwd=self.folder, check=False).stdout

    def logs_of(self, rigel: Rigel) -> str:
        """Return what the node has printed in its present pod."""
        return rigel("logs", "motor", cwd=self.folder).stdout


@pytest.fixture
def world(
    rigel_as_deployer: Rigel,
    deployer_config: Path,
    context: str,
    cluster: Any,
    namespace: str,
    registry: str,
    tmp_path: Path,
) -> World:
    """The release, deployed with the deployer's rights."""
    nodes = {"motor": {"command": ["sh", "-c", PROGRAM]}, "other": {}}
    write_idle(tmp_path, namespace, registry, nodes)
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    place = ["--kubeconfig", str(deployer_config), "--context", context]
    return World(cluster, namespace, place, tmp_path)


def test_a_saved_file_runs_in_the_same_pod(world: World, rigel_as_deployer: Rigel) -> None:
    """The other node is untouched; Ctrl-C brings the release back, and the files are gone."""
    before, deployed = world.pods(), world.deployment()
    running = world.start()
    developed = world.pods()
    assert developed["other"] == before["other"]
    assert developed["motor"] != before["motor"]

    (world.source / "sub").mkdir()
    (world.source / "sub" / "late").write_text("x")
    (world.source / ".git").mkdir()
    (world.source / ".git" / "index").write_text("x")
    world.save("two")
    world.expect(running, "runs two")
    assert list_files(rigel_as_deployer, world) == ["/app/sub/late", "/app/text"]
    (world.source / "sub" / "late").unlink()
    world.expect(running, "0 files copied, 1 removed")
    until(lambda: list_files(rigel_as_deployer, world) == ["/app/text"], "end of the file", 120)
    assert world.pods() == developed
    assert "in development by" in world.status(rigel_as_deployer)

    second = rigel_as_deployer(
        "dev", "motor", "--sync", f"{world.source}:/app", cwd=world.folder, check=False
    )
    assert second.returncode == 2
    assert "motor is in development by" in second.stderr

    assert running.interrupt() == 130
    assert world.deployment() == deployed
    after = world.pods()
    assert after["other"] == before["other"]
    assert after["motor"] != developed["motor"]
    assert "runs release" in world.logs_of(rigel_as_deployer)
    assert "in development" not in world.status(rigel_as_deployer)
    assert rigel_as_deployer("diff", cwd=world.folder).stdout == ""


def list_files(rigel: Rigel, world: World) -> list[str]:
    """Return the files in the container."""
    found = rigel("exec", "motor", "--", "find", "/app", "-type", "f", cwd=world.folder)
    return sorted(found.stdout.split())


def test_a_killed_session_is_put_right_by_the_next_run(
    world: World, rigel_as_deployer: Rigel
) -> None:
    """Until then `status` names it; a second session takes its place."""
    deployed = world.deployment()
    first = world.start()
    first.interrupt(signal.SIGKILL)
    second = world.start()
    second.interrupt(signal.SIGKILL)
    assert "motor is in development by" in world.status(rigel_as_deployer)
    rigel_as_deployer("run", "job", "deploy", cwd=world.folder)
    assert world.deployment() == deployed
    assert "in development" not in world.status(rigel_as_deployer)
    assert "runs release" in world.logs_of(rigel_as_deployer)


def test_a_deploy_by_another_process_ends_the_session(
    world: World, rigel_as_deployer: Rigel
) -> None:
    """It says why, and leaves alone what the other one has deployed."""
    deployed = world.deployment()
    running = world.start()
    rigel_as_deployer("run", "job", "deploy", cwd=world.folder)
    pods = world.pods()
    world.expect(running, "another process has deployed motor")
    assert running.interrupt() == 1
    assert (world.pods(), world.deployment()) == (pods, deployed)


@pytest.fixture
def relay(world: World, deployer_config: Path, context: str, tmp_path: Path) -> Iterator[Relay]:
    """A connection to the cluster that can be cut, for what `world` starts."""
    config = yaml.safe_load(deployer_config.read_text())
    name = next(c["context"]["cluster"] for c in config["contexts"] if c["name"] == context)
    (chosen,) = (one["cluster"] for one in config["clusters"] if one["name"] == name)
    server = urlsplit(chosen["server"])
    assert server.hostname
    assert server.port
    with relaying(server.hostname, server.port) as made:
        chosen["server"] = f"https://127.0.0.1:{made.port}"
        chosen["tls-server-name"] = server.hostname
        place = tmp_path / "relayed"
        place.write_text(yaml.safe_dump(config))
        world.place[1] = str(place)
        yield made


def test_a_lost_connection_ends_neither_the_session_nor_its_good_end(
    world: World, relay: Relay, rigel_as_deployer: Rigel
) -> None:
    """What is saved meanwhile is copied when the cluster answers; so it is with Ctrl-C."""
    before, deployed = world.pods(), world.deployment()
    running = world.start()
    developed = world.pods()
    relay.cut()
    world.expect(running, "waiting up to")
    world.save("two")
    relay.mend()
    world.expect(running, "runs two")
    assert world.pods() == developed

    relay.cut()
    ended: list[int] = []
    end = Thread(target=lambda: ended.append(running.interrupt()))
    end.start()
    world.expect(running, "motor gets the release's version again")
    relay.mend()
    end.join()
    assert ended == [130], running.lines
    assert world.deployment() == deployed
    assert world.pods()["other"] == before["other"]
    assert "in development" not in world.status(rigel_as_deployer)
