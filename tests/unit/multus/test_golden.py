"""What is installed on each kind of cluster; a change restarts the network of every node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.network.options import Install
from rigel_k8s.objects.refs import ref_of
from rigel_multus.installation import Installation, Presence
from rigel_multus.manifests import network_release
from rigel_multus.platform import Group, Platform, platform
from tests.support.golden import Golden

GOLDEN = Path(__file__).parent / "golden"
SCRIPT = "# machine.sh\n"


def on(*platforms: Platform, options: Install | None = None, **how: Any) -> Installation:
    """Return an installation on one node of each platform."""
    groups = [Group(where, (f"robot{number}",)) for number, where in enumerate(platforms)]
    return Installation(groups, options or Install(), **how)


K3S = platform("k3s", version="v1.34.4+k3s1")
OWN_IMAGES = Install(
    multus_image="registry.lab/multus:1",
    whereabouts_image="registry.lab/whereabouts:1",
    plugins_image="registry.lab/plugins:1",
)
CASES = {
    "plain": on(platform("plain")),
    "k3s": on(K3S),
    "k3s-old": on(platform("k3s", version="v1.27.4+k3s1")),
    "microk8s": on(platform("microk8s")),
    "kind": on(platform("kind")),
    "minikube": on(platform("minikube")),
    "mixed": on(K3S, platform("k3s", version="v1.34.4+k3s1", data_dir="/data")),
    "own-images": on(platform("plain"), options=OWN_IMAGES),
    "others-multus": on(platform("plain"), parts={"multus": Presence((), ours=False)}),
    "retired": on(platform("plain"), retired=True),
}
#: What does not depend on the kind of cluster stands in one file.
SAME = ("CustomResourceDefinition", "ServiceAccount", "Role", "ClusterRole", "RoleBinding")
ALIKE = (*SAME, "ClusterRoleBinding")


def objects(installation: Installation) -> list[Any]:
    """Return what depends on the kind of cluster."""
    found = network_release(installation, SCRIPT).objects
    return [item for item in found if item["kind"] not in ALIKE]


def make(case: str) -> list[Any]:
    """Return what a file has; "alike": what does not depend on the kind of cluster."""
    if case != "alike":
        return objects(CASES[case])
    found = network_release(CASES["plain"], SCRIPT).objects
    return [item for item in found if item["kind"] in ALIKE]


FOLDER = Golden(GOLDEN, make, ("alike", "plain", "k3s"), CASES)


@pytest.mark.parametrize("case", CASES)
def test_installations_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    """Each kind of cluster gets what its golden file says."""
    FOLDER.compare(case, update=update_golden)


def test_kinds_and_rights_are_those_of_the_golden_file(*, update_golden: bool) -> None:
    """Definitions and rights are the same everywhere."""
    found = network_release(CASES["plain"], SCRIPT).objects
    FOLDER.compare("alike", update=update_golden)
    for case in ("k3s", "microk8s", "kind"):
        there = network_release(CASES[case], SCRIPT).objects
        assert [i for i in there if i["kind"] in ALIKE] == [i for i in found if i["kind"] in ALIKE]


def test_golden_files_have_their_case() -> None:
    """No golden file outlives its case."""
    assert {path.stem for path in GOLDEN.glob("*.yaml")} == {*CASES, "alike"}


def test_definitions_outlive_the_release() -> None:
    """With a definition would go every attachment; others' definitions are not touched."""
    found = network_release(CASES["plain"], SCRIPT)
    definitions = [i for i in found.objects if i["kind"] == "CustomResourceDefinition"]
    assert len(definitions) == 4
    assert found.protected == {ref_of(item) for item in definitions}
    name = definitions[0]["metadata"]["name"]
    theirs = network_release(on(platform("plain"), foreign=frozenset({name})), SCRIPT)
    assert name not in [item["metadata"]["name"] for item in theirs.objects]


def test_a_change_of_the_script_rolls_the_pods() -> None:
    """A new script, or a new configuration, reaches the machines."""

    def marks(installation: Installation, script: str) -> list[str]:
        found = network_release(installation, script).objects
        sets = [i for i in found if i["kind"] == "DaemonSet"]
        return [str(s["spec"]["template"]["metadata"]["annotations"]) for s in sets]

    plain = CASES["plain"]
    assert marks(plain, SCRIPT)
    assert not set(marks(plain, SCRIPT)) & set(marks(plain, f"{SCRIPT}# new\n"))
