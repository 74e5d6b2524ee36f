"""A node's `files`: what lies beside the Rigelfile, as it is mounted, and what is refused."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.app.deploying.localfiles import MOST_BYTES, MOST_FILES, check_local_files, read_files
from rigel_k8s.errors import UserError

from .shapes import options, problems, release

NODE = "image: r/i:1\nnodes:\n  n:\n    args: [rosrun, a, b]\n    files: "


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder, a program and a layout beside a Rigelfile."""
    made = tmp_path / "home"
    (made / "maps/floor 1").mkdir(parents=True)
    (made / "maps/lab.yaml").write_text("resolution: 0.05\n")
    (made / "maps/floor 1/lab.pgm").write_bytes(b"P5\xff\x00")
    (made / "layout.json").write_text("{}")
    (made / "start.sh").write_text("#!/bin/sh\n")
    (made / "start.sh").chmod(0o755)
    return made


def deploy(home: Path, files: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the ConfigMap and the pod's spec of a node with these files."""
    text = NODE + files
    made = release(text, folders=read_files(options(text), home, home)).objects
    (config,) = (item for item in made if "-files-" in item["metadata"]["name"])
    (node,) = (item for item in made if item["metadata"]["name"] == "n" and "spec" in item)
    return config, node["spec"]["template"]["spec"]


def mounted(pod: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the mounts of the files, by their paths, each with its volume's ConfigMap."""
    volumes = {one["name"]: one["configMap"] for one in pod["volumes"] if "configMap" in one}
    mounts = pod["containers"][0]["volumeMounts"]
    return {
        one["mountPath"]: {**volumes[one["name"]], **one}
        for one in mounts
        if one["name"].startswith("files-")
    }


def test_a_folder_is_mounted_as_it_is(home: Path) -> None:
    """Text and other files, below folders, with names that no key of a ConfigMap may have.

    The top folder of a volume has links to hidden folders in it: a search finds files thrice.
    """
    config, pod = deploy(home, "{/maps: maps/}")
    mount = mounted(pod)["/maps"]
    assert mount["readOnly"] is True
    assert mount["subPath"] == "maps"
    assert mount["name"] in {one["name"] for one in pod["volumes"]}
    paths = {item["path"]: item["key"] for item in mount["items"]}
    assert set(paths) == {"maps/lab.yaml", "maps/floor 1/lab.pgm"}
    assert config["data"] == {paths["maps/lab.yaml"]: "resolution: 0.05\n"}
    assert base64.b64decode(config["binaryData"][paths["maps/floor 1/lab.pgm"]]) == b"P5\xff\x00"
    assert all(set(key) <= set("0123456789.abcdefghijklmnopqrstuvwxyz_") for key in paths.values())


def test_a_file_covers_nothing_beside_it(home: Path) -> None:
    """One that may be executed here may be there, too."""
    _, pod = deploy(home, "{/app/layout.json: layout.json, /app/start: start.sh}")
    layout, start = mounted(pod)["/app/layout.json"], mounted(pod)["/app/start"]
    assert layout["subPath"] == layout["items"][0]["path"] == "layout.json"
    assert "mode" not in layout["items"][0]
    assert start["items"][0]["mode"] == 0o755
    assert layout["name"] != start["name"]


def test_a_changed_file_gives_its_node_new_pods_that_have_it(home: Path) -> None:
    """The old pods keep the ConfigMap with which they started; other nodes stay as they are."""
    files = "{/app/layout.json: layout.json}\n  other: {args: [rosrun, a, c]}"
    before, old = deploy(home, files)
    (home / "layout.json").write_text("[]")
    after, new = deploy(home, files)
    assert before["metadata"]["name"] != after["metadata"]["name"]
    assert mounted(old)["/app/layout.json"]["items"] == mounted(new)["/app/layout.json"]["items"]
    assert old != new
    text = NODE + files
    made = release(text, folders=read_files(options(text), home, home)).objects
    assert sum("-files-" in item["metadata"]["name"] for item in made) == 1


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("nothing", "No such file"),
        ("empty", "is an empty folder"),
        ("../secret", "outside the Rigelfile's directory"),
        ("linked", "cannot read"),
        ("pipe", "not a regular file"),
        ("loop", "symbolic link"),
        ("large", f"more than {MOST_BYTES} bytes"),
        ("many", f"more than {MOST_FILES}"),
    ],
)
def test_what_cannot_be_mounted_is_refused_at_its_place(
    home: Path, path: str, message: str
) -> None:
    """`check` reports the same as a deploy."""
    for folder in ("empty", "linked", "many"):
        (home / folder).mkdir()
    (home.parent / "secret").write_text("key")
    (home / "linked/out").symlink_to(home / "maps")
    os.mkfifo(home / "pipe")
    (home / "loop").symlink_to(home / "loop")
    (home / "large").write_bytes(b"0" * (MOST_BYTES + 1))
    for number in range(MOST_FILES + 1):
        (home / f"many/{number}").write_text("")
    asked = options(NODE + f"{{/x: {path}}}")
    (problem,) = check_local_files(asked, home, home)
    assert problem.path == ("nodes", "n", "files", "/x")
    assert message in problem.message
    with pytest.raises(UserError, match=r"nodes\.n\.files\./x"):
        read_files(asked, home, home)


def test_files_of_all_nodes_count_together(home: Path) -> None:
    """A revision keeps all of them, each as often as it is mounted."""
    for name in "ab":
        (home / name).write_bytes(b"0" * (MOST_BYTES // 2 + 1))
    asked = options(NODE + "{/a: a}\n  other: {args: [rosrun, a, c], files: {/b: b}}")
    (problem,) = check_local_files(asked, home, home)
    assert problem.path == ("nodes", "other", "files", "/b")
    assert "the files of all nodes have more than 512 KiB" in problem.message


def test_a_path_with_a_template_waits(home: Path) -> None:
    """Only a run knows it."""
    asked = options(NODE + "{/x: '{{ data.file }}'}")
    assert list(check_local_files(asked, home, home)) == []


def test_two_mounts_at_one_path_are_refused() -> None:
    """Kubernetes would refuse the pod."""
    text = NODE + "{/maps/: maps}\n    volumes: [{config_map: m, mount_path: /maps}]"
    (problem,) = problems(text)
    assert (problem.path, problem.kind) == (("nodes", "n", "volumes", 0), "conflict")
