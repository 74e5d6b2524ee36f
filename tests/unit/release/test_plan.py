"""The pure part of a deploy: what is sent, what is unchanged, what is done, what is refused."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.difference import difference
from rigel_k8s.release.labelling import covers, hash_of, managers, manifests_to_apply, take_over
from rigel_k8s.release.refusals.foresight import Foreseen
from rigel_k8s.release.refusals.verdict import Refused, check
from rigel_k8s.release.survey import Survey
from rigel_k8s.release.types import Desired, InventoryItem, Revision, Step, rank
from tests.support.manifests import RELEASE, make


def test_what_is_sent_is_labelled_hashed_and_in_order() -> None:
    """Configuration before services before workloads; the hash is of all that is said."""
    one = Desired(RELEASE, (make("Deployment", "d"), make("Service", "s"), make("ConfigMap", "c")))
    sent = manifests_to_apply(one)
    assert [m["kind"] for m in sent] == ["ConfigMap", "Service", "Deployment"]
    assert all(m["metadata"]["labels"][RELEASE_LABEL] == "demo" for m in sent)
    assert manifests_to_apply(attrs.evolve(one, objects=sent)) == sent, (
        "what is prepared stays as it is"
    )
    other = manifests_to_apply(Desired(RELEASE, (make("ConfigMap", "c", data={"a": "1"}),)))
    assert hash_of(other[0]) != hash_of(sent[0])


def test_cluster_wide_objects_say_which_namespaces_release_they_are_of() -> None:
    """A release's name alone does not tell two namespaces apart."""
    [sent] = manifests_to_apply(Desired(RELEASE, (make("PersistentVolume", "v"),)))
    assert sent["metadata"]["annotations"]["rigel-k8s/namespace"] == "n"


def test_string_data_becomes_data() -> None:
    """Kubernetes never shows stringData, so it could not be compared."""
    [sent] = manifests_to_apply(Desired(RELEASE, (make("Secret", "s", stringData={"p": "x"}),)))
    assert sent["data"] == {"p": base64.b64encode(b"x").decode()}
    assert "stringData" not in sent


OWNED = {
    "f:spec": {
        "f:replicas": {},
        "f:list": {
            'k:{"containerPort":80,"protocol":"TCP"}': {".": {}, "f:containerPort": {}},
            'v:"x"': {},
        },
        "f:atomic": {},
    }
}


@pytest.mark.parametrize(
    ("spec", "owned"),
    [
        ({"replicas": 1}, True),
        ({"paused": True}, False),
        ({"list": [{"containerPort": 80}]}, True),
        ({"list": [{"containerPort": 81}]}, False),
        ({"list": [{"containerPort": 80, "name": "http"}]}, False),
        ({"list": ["x"]}, True),
        ({"list": ["y"]}, False),
        ({"atomic": {"any": {"thing": 1}}}, True),
        ({"empty": {}, "none": None}, True),
    ],
)
def test_ownership_is_read_from_managed_fields(spec: dict[str, Any], owned: object) -> None:
    """Fields, list items by key (with defaults) and by value, atomic values, empty ones."""
    live = make("Deployment", "d")
    entry = {"manager": "rigel", "operation": "Apply", "apiVersion": "v1", "fieldsV1": OWNED}
    live["metadata"]["managedFields"] = [entry]
    assert covers(make("Deployment", "d", spec=spec), live) == owned


def test_taking_over_makes_other_tools_fields_ours_and_leaves_controllers_alone() -> None:
    """kubectl's and Helm's become ours; what Kubernetes' controllers set stays theirs."""
    live = make("Deployment", "d")
    live["metadata"]["managedFields"] = [
        {"manager": "helm", "operation": "Update", "apiVersion": "v1", "fieldsV1": {"f:a": {}}},
        {"manager": "rigel", "operation": "Apply", "apiVersion": "v1", "fieldsV1": {"f:b": {}}},
        {"manager": "kube-controller-manager", "operation": "Update", "fieldsV1": {"f:c": {}}},
        {"manager": "x", "operation": "Update", "subresource": "status", "fieldsV1": {"f:d": {}}},
    ]
    assert managers(live) == ("helm",)
    *others, ours = take_over(live)
    assert [entry["manager"] for entry in others] == ["kube-controller-manager", "x"]
    assert (ours["manager"], ours["operation"]) == ("rigel", "Apply")
    assert ours["fieldsV1"] == {"f:a": {}, "f:b": {}}


def test_refusals_come_all_at_once_with_their_paths() -> None:
    """Two objects of another release: both told, where they came from, before any conflict."""
    desired = Desired(RELEASE, (make("ConfigMap", "a"), make("ConfigMap", "b")))
    desired = attrs.evolve(desired, origins={ref_of(desired.objects[1]): ("nodes", "b")})
    live = []
    for name in ("a", "b"):
        other = make("ConfigMap", name)
        other["metadata"]["labels"] = {RELEASE_LABEL: "other"}
        live.append(other)
    there = {ref_of(o): o for o in live}
    sent = manifests_to_apply(desired)
    survey = Survey(desired, sent, there, Foreseen(there), make("Namespace", "n"), [], None)
    with pytest.raises(Refused) as caught:
        check(survey, adopt=True)
    assert [p.path for p in caught.value.problems] == [(), ("nodes", "b")]
    assert caught.value.exit_code == 2


def test_a_record_keeps_everything_but_secrets() -> None:
    """Written and read again it is the same revision."""
    objects = (make("ConfigMap", "c", data={"a": "1"}), make("Secret", "s", data={"p": "eA=="}))
    items = tuple(InventoryItem(ref_of(o), "u") for o in objects)
    revision = Revision(
        RELEASE, 7, "good", "2026-01-01T00:00:00Z", objects, items, {"x": 1}, "d", "1"
    )
    record = revisions.record(revision)
    assert record.revision() == attrs.evolve(revision, objects=objects[:1])
    assert record.secret["metadata"]["name"] == "rigel.demo.v7"
    assert b"eA==" not in gzip.decompress(base64.b64decode(record.secret["data"]["release"]))


def test_a_record_of_a_later_format_says_so() -> None:
    """Instead of being misread."""
    record = revisions.record(Revision(RELEASE, 1, "good", "", (), (), tool_version="9.9"))
    payload = gzip.compress(json.dumps({"format": 2}).encode())
    record.secret["data"]["release"] = base64.b64encode(payload).decode()
    with pytest.raises(ClusterError, match="its format is 2") as caught:
        record.revision()
    assert "9.9" in (caught.value.hint or "")


def test_a_difference_shows_lines_and_hides_secrets() -> None:
    """As diff -u; a changed secret is told as changed without its value."""
    one, two = (
        {**make("Secret", "s", data={"p": value, "q": "same"}), "type": "Opaque"}
        for value in ("b2xk", "bmV3")
    )
    step = Step("change", ref_of(one), two, one, two)
    text = difference([step])
    assert "-  p: (hidden, as it is)\n+  p: (hidden, changed)\n   q: (hidden)\n" in text
    assert "b2xk" not in text
    assert difference([Step("keep", ref_of(one), one, one, one)]) == ""


def test_a_difference_shows_which_binary_file_it_is() -> None:
    """Not kilobytes of base64; the same name may stand for another library."""
    one, two = (
        make("ConfigMap", "c", data={"a.sh": "exit"}, binaryData={"a.so": value})
        for value in ("b2xk", "bmV3")
    )
    text = difference([Step("change", ref_of(one), two, one, two)])
    assert "b2xk" not in text
    assert "-  a.so: (3 bytes, sha256 " in text
    assert "+  a.so: (3 bytes, sha256 " in text


def config_steps(old: str, new: str) -> list[Step]:
    """Return the steps for a changed file: its ConfigMap gets another name."""
    before = make("ConfigMap", "n-files-0123456789", data={"a.sh": old, "b.sh": "b\n" * 9})
    after = make("ConfigMap", "n-files-abcdef0123", data={"a.sh": new, "b.sh": "b\n" * 9})
    return [
        Step("create", ref_of(after), after, None, after),
        Step("prune", ref_of(before), None, before, None),
    ]


def test_a_changed_line_of_a_file_is_the_one_that_is_shown() -> None:
    """Its ConfigMap has another name then. Tabs and spaces at the end of a line change nothing."""
    whole = "#!/bin/sh\r\nif x; then \n\techo %s\nfi"
    steps = config_steps(whole % "one", whole % "two")
    text = difference(steps)
    changed = [line for line in text.splitlines() if line[0] in "+-"]
    assert changed == [
        "--- ConfigMap n/n-files-0123456789 (cluster)",
        "+++ ConfigMap n/n-files-abcdef0123 (Rigelfile)",
        "-    \techo one",
        "+    \techo two",
        "-  name: n-files-0123456789",
        "+  name: n-files-abcdef0123",
    ]
    assert "   a.sh: |-\n     #!/bin/sh\\r\n     if x; then \n" in text


def test_the_file_of_a_changed_line_is_named() -> None:
    """As lines above do not show it; a head in the file itself is none."""
    text = "run: |\n" + "  same\n" * 9
    text = difference(config_steps(f"{text}one\n", f"{text}two\n"))
    hunks = [line.rpartition("@@")[2] for line in text.splitlines() if line.startswith("@@")]
    assert hunks == [" a.sh", ""]


def test_of_several_old_objects_one_is_compared_and_none_is_hidden() -> None:
    """Those that an interrupted deploy left are removed, too."""
    create, prune = config_steps("a\nb\n", "a\nc\n")
    left = make("ConfigMap", "n-files-1111111111", data={"a.sh": "!lines 0"})
    text = difference([create, Step("prune", ref_of(left), None, left, None), prune])
    assert "-    b\n+    c\n" in text
    assert "-  a.sh: |-\n-    !lines 0\n" in text
    assert "-  name: n-files-1111111111" in text


def files_steps(node: str, old: dict[str, str], new: dict[str, str]) -> list[Step]:
    """Return the steps for the changed files of a node."""
    found = [
        make("ConfigMap", f"{node}-files-{digest * 10}", data=data)
        for digest, data in (("0", old), ("1", new))
    ]
    for one in found:
        one["metadata"]["labels"] = {NAME_LABEL: node}
    before, after = found
    return [
        Step("create", ref_of(after), after, None, after),
        Step("prune", ref_of(before), None, before, None),
    ]


def test_a_file_of_several_nodes_is_shown_once() -> None:
    """With the nodes that it restarts; a file that one of them has alone is shown with that."""
    old, new = "speed: 1\n", "speed: 2\n"
    text = difference(
        [
            *files_steps("lidar", {"0.0.a.yaml": old}, {"0.0.a.yaml": new}),
            *files_steps("map", {"0.0.a.yaml": old}, {"0.0.a.yaml": new}),
            *files_steps(
                "nav", {"0.0.b": "x", "1.0.a.yaml": old}, {"0.0.b": "y", "1.0.a.yaml": new}
            ),
        ]
    )
    assert (text.count("+    speed: 2"), text.count("+  0.0.b: y")) == (1, 1)
    assert "0.0.a.yaml: the same change restarts map and nav\n" in text
    assert [line for line in text.splitlines() if line.startswith("+++")] == [
        "+++ ConfigMap n/lidar-files-1111111111 (Rigelfile)",
        "+++ ConfigMap n/nav-files-1111111111 (Rigelfile)",
    ]


def test_unknown_kinds_come_before_workloads() -> None:
    """A custom resource may be what a pod needs."""
    assert rank("Service") < rank("Robot") < rank("Deployment")
