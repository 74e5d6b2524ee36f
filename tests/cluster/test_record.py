"""`record` on a real cluster: bags arrive as they are there, and an update closes the last one."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.until import until

from .conftest import Rigel, inside

pytestmark = pytest.mark.cluster

TALK = ["rostopic", "pub", "--rate", "20", "/chatter", "std_msgs/String", "data: hello"]
COUNT = "import rosbag, sys; print(rosbag.Bag(sys.argv[1]).get_message_count('/chatter'))"


def write(folder: Path, namespace: str, image: str, split: str) -> None:
    """Write the Rigelfile of a talker and its recorder."""
    record = {"topics": ["/chatter"], "split": split, "limit": "64Mi"}
    own = {"namespace": namespace, "image": image, "record": record}
    options = {**own, "nodes": {"talker": {"args": TALK}}}
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}}
    whole = {"application": {"distro": "noetic"}, "jobs": jobs}
    (folder / "Rigelfile").write_text(yaml.safe_dump(whole))


def test_bags_of_a_release(
    rigel_as_deployer: Rigel, cluster: Any, namespace: str, base_image: str, tmp_path: Path
) -> None:
    """Fetched while others are being written; what is written is closed before the pod ends."""

    def rigel(*words: str, check: bool = True) -> Any:
        return rigel_as_deployer(*words, cwd=tmp_path, check=check)

    def bags() -> dict[str, str]:
        found = json.loads(rigel("bags", "list", "-o", "json").stdout)
        return {bag["bag"]: bag["state"] for bag in found}

    def count(name: str) -> int:
        path = f"/persistent/bags/{name}"
        return int(inside(cluster, namespace, "recorder", "python3", "-c", COUNT, path))

    write(tmp_path, namespace, base_image, "3s")
    rigel("run", "job", "deploy")
    until(lambda: "closed" in bags().values(), "a closed bag", 60, last_words=bags)
    rigel("bags", "fetch", "--to", "bags")
    first = min(path.name for path in (tmp_path / "bags").iterdir())
    there = inside(cluster, namespace, "recorder", "sha256sum", f"/persistent/bags/{first}")
    assert hashlib.sha256((tmp_path / "bags" / first).read_bytes()).hexdigest() == there.split()[0]
    assert count(first) > 10

    write(tmp_path, namespace, base_image, "1h")
    rigel("run", "job", "deploy")
    *closed, last = sorted(bags().items())
    assert {state for _, state in closed} == {"closed"}
    assert last[1] == "recording"
    assert count(closed[-1][0]) > 0

    refused = rigel("bags", "delete", last[0], "-y", check=False)
    assert (refused.returncode, "is being written" in refused.stderr) == (2, True)
    rigel("bags", "delete", "--all", "-y")
    assert bags() == {last[0]: "recording"}
