"""What a failed roll-out advises, by its cause."""

from __future__ import annotations

from typing import Any, cast

import pytest

from rigel_k8s.objects.marks import IMAGE_ANNOTATION
from rigel_k8s.release.rollout.account import Account
from rigel_k8s.release.rollout.causes import Cause
from rigel_k8s.release.rollout.patience import Ledger, Patience
from rigel_k8s.release.rollout.standing import Standing
from tests.support.manifests import claim, desired, make, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import make_run

TALKER = ref("Deployment", "talker")
LINE = "[ERROR] Error writing: Error opening file: /bags/run.bag.active"


def advise(target: dict[str, Any], cause: Cause, *others: dict[str, Any], log: str = "") -> str:
    """Return the hint for a workload of a release with other objects."""
    run = make_run(desired(target, *others), cast(Any, None), report=Recorder())
    account = Account(run, Standing({TALKER: target}), 0, Ledger(Patience()))
    return account.choose_hint(TALKER, cause, [log])


def test_an_image_that_another_option_sets_is_told_with_it() -> None:
    """Roscore's image is a name that no user has written."""
    master = workload(**{IMAGE_ANNOTATION: "set `ros_master_image`"})
    hint = advise(master, Cause("image", "cannot be pulled"))
    assert hint.startswith("set `ros_master_image`; push it")


@pytest.mark.parametrize("key", ["command", "args"])
def test_a_command_that_does_not_find_ros_has_its_hint(key: str) -> None:
    """The image's ENTRYPOINT loads ROS, and `command` takes its place."""
    node = workload()
    node["spec"]["template"]["spec"]["containers"][0][key] = ["python3", "talker.py"]
    cause = Cause("crash", "ModuleNotFoundError: No module named 'rospy'", container="node")
    assert ("use `args`" in advise(node, cause)) is (key == "command")


@pytest.mark.parametrize(
    ("volume", "mount", "line", "named"),
    [
        ({"hostPath": {"path": "/srv/bags"}}, {}, LINE, True),
        ({"persistentVolumeClaim": {"claimName": "bags-pvc"}}, {}, LINE, True),
        ({"persistentVolumeClaim": {"claimName": "other"}}, {}, LINE, False),
        ({"hostPath": {"path": "/srv/bags"}}, {"readOnly": True}, LINE, False),
        ({"hostPath": {"path": "/srv/bags"}}, {}, "[ERROR] no such topic", False),
        ({"hostPath": {"path": "/srv/bags"}}, {}, "writing to /bags/run", False),
        ({"emptyDir": {}}, {}, LINE, False),
    ],
)
def test_a_folder_of_the_machine_that_cannot_be_written_is_named(
    volume: Any, mount: Any, line: str, *, named: bool
) -> None:
    """The program names where it sees the folder, and its exit code may be 0."""
    node = workload()
    pod = node["spec"]["template"]["spec"]
    pod["volumes"] = [{"name": "v", **volume}]
    pod["containers"][0]["volumeMounts"] = [{"name": "v", "mountPath": "/bags", **mount}]
    held = claim("bags-pvc", volumeName="bags-pv", storageClassName="")
    disk = make("PersistentVolume", "bags-pv", spec={"hostPath": {"path": "/srv/bags"}})
    hint = advise(node, Cause("crash", "exited with code 0"), held, disk, log=line)
    assert ("write to /srv/bags of its machine" in hint) is named
