"""What a deploy refuses before its first write: pods and rights."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError, ConflictError
from rigel_k8s.kube.failures import Forbidden, Refusal, refusal
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.refusals.foresight import choose_trials, contains
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import Desired
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, make, workload
from tests.support.releases import deploy, diff

POD_SECURITY = (
    'pods "talker-x7k" is forbidden: violates PodSecurity "restricted:latest": runAsNonRoot != true'
    ' (pod or container "talker" must set securityContext.runAsNonRoot=true)'
)
DEPLOYMENTS = {"apiGroups": ["apps"], "resources": ["deployments"], "verbs": ["list", "watch"]}


def refuse_pods(message: str, status: int = 403) -> Callable[[Any, bool], Refusal | None]:
    """Return an admission that refuses pods and nothing else."""

    def refuse(live: Any, dry_run: Any) -> Refusal | None:
        if live["kind"] != "Pod":
            return None
        answer = json.dumps({"message": message}).encode()
        return refusal(status, answer, "create Pod n/", context="c", server="s")

    return refuse


def raising(error: ClusterError) -> Callable[..., None]:
    def refuse(*_: Any, **__: Any) -> None:
        raise error

    return refuse


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (POD_SECURITY, "pod-security"),
        ('pods "talker-x" is forbidden: failed quota: small: must specify cpu', "no-resources"),
        (
            'pods "t-1" is forbidden: maximum cpu usage per Container is 1, but limit is 2',
            "limit-range",
        ),
        ('admission webhook "policy.example.org" denied the request: no', "policy"),
        ('pods "talker-x" is forbidden: exceeded quota: small, requested: pods=1', "quota"),
    ],
)
def test_refused_pods_are_known_before_any_write(
    fake: Any, report: Any, message: str, kind: str
) -> None:
    """With the ground, the place of the workload, and the way out that is known for it."""
    fake.store.refuse = refuse_pods(message)
    talker = workload()
    wanted = Desired(
        RELEASE,
        (talker, config("c")),
        origins={ref_of(talker): ("nodes", "talker")},
        remedies={kind: "do this"},
    )
    with pytest.raises(Refused) as caught:
        deploy(wanted, fake, report=report)
    [problem] = caught.value.problems
    assert (problem.path, problem.kind) == (("nodes", "talker"), kind)
    assert problem.message.startswith("Deployment n/talker: the cluster refuses its pods: ")
    assert problem.message.endswith("; do this")
    assert fake.writes == []
    with pytest.raises(Refused):
        diff(wanted, fake)


@pytest.mark.parametrize(
    ("live", "wanted", "same"),
    [
        ({"args": ["a", "b"]}, {"args": ["a"]}, False),
        ({"args": ["a"]}, {"args": ["a", "b"]}, False),
        ({"args": ["a"], "dnsPolicy": "ClusterFirst"}, {"args": ["a"]}, True),
        ({"dnsPolicy": "ClusterFirst"}, {"dnsPolicy": None}, True),
        ({}, {"args": []}, False),
    ],
)
def test_what_kubernetes_adds_to_a_template_is_no_change(live: Any, wanted: Any, same: Any) -> None:
    """A list that became shorter is one: each of its items is still there."""
    assert contains(live, wanted) is same


def test_a_conflict_of_the_moment_is_not_the_objects_fault(fake: Any, report: Any) -> None:
    """No other manager owns a field: someone wrote the object just then."""

    def refuse(live: Any, dry_run: Any) -> Refusal | None:
        answer = b'{"message": "the object has been modified"}'
        return refusal(409, answer, "apply", context="c", server="s") if dry_run else None

    fake.store.refuse = refuse
    with pytest.raises(ConflictError, match="has been modified"):
        deploy(desired(config()), fake, report=report)


def test_nothing_is_tried_in_a_namespace_to_come(fake: Any) -> None:
    """Everything would be refused there."""
    del fake.objects[ObjectRef("v1", "Namespace", "", "n")]
    wanted = attrs.evolve(desired(workload(), config()), create_namespace=True)
    assert len(diff(wanted, fake).changes) == 3
    assert not [call for call in fake.calls if call[0] == "try"]


def test_one_reason_for_many_workloads_is_one_problem(fake: Any, report: Any) -> None:
    """The reason names each workload's own container: that is no difference."""

    def refuse(live: Any, dry_run: Any) -> Refusal | None:
        name = live["metadata"].get("generateName", "").rstrip("-")
        return refuse_pods(POD_SECURITY.replace("talker", name))(live, dry_run)

    fake.store.refuse = refuse
    with pytest.raises(Refused) as caught:
        deploy(Desired(RELEASE, tuple(workload(f"w{i}") for i in range(5))), fake, report=report)
    [problem] = caught.value.problems
    assert problem.message.startswith("Deployment n/w0, w1, w2 and 2 more: ")


@pytest.mark.parametrize("status", [403, 500, 503])
def test_what_cannot_be_tried_is_not_refused(fake: Any, report: Any, status: int) -> None:
    """Neither without the right to create pods, nor where a webhook takes no dry run."""
    text = 'pods is forbidden: User "ada" cannot create resource "pods" in API group ""'
    fake.store.refuse = lambda live, dry_run: (
        refuse_pods(text, status)(live, dry_run) if dry_run else None
    )
    assert deploy(Desired(RELEASE, (workload(),)), fake, report=report).status == "good"


def test_a_template_that_stays_is_not_tried_again(fake: Any, report: Any) -> None:
    """Neither in an unchanged deploy nor where something else of the workload changes."""
    wanted = workload()
    deploy(Desired(RELEASE, (wanted,)), fake, report=report)
    fake.calls.clear()
    more = {**wanted, "metadata": {**wanted["metadata"], "annotations": {"a": "b"}}}
    deploy(Desired(RELEASE, (more,)), fake, report=report)
    assert [ref.kind for verb, ref in fake.calls if verb == "try"] == ["Deployment"]
    fake.calls.clear()
    deploy(Desired(RELEASE, (more,)), fake, report=report)
    assert {verb for verb, _ in fake.calls} == {"get", "list"}


def test_the_same_template_is_tried_once(fake: Any, report: Any) -> None:
    """However many workloads have it."""
    one = workload("a")
    two = {**one, "metadata": {**one["metadata"], "name": "b"}}
    diff(Desired(RELEASE, (one, two)), fake)
    assert [ref.kind for verb, ref in fake.calls if verb == "try"].count("Pod") == 1


def test_an_account_that_is_to_come_does_not_refuse_its_pods(fake: Any) -> None:
    """A service account of the release itself is not there when its pods are tried."""
    user = workload()
    user["spec"]["template"]["spec"]["serviceAccountName"] = "robot"
    seen = []
    fake.store.refuse = lambda live, dry_run: seen.append(live)
    diff(Desired(RELEASE, (user, make("ServiceAccount", "robot"))), fake)
    [pod] = [live for live in seen if live["kind"] == "Pod"]
    assert "serviceAccountName" not in pod["spec"]


@pytest.mark.parametrize("kind", ["Deployment", "DaemonSet", "StatefulSet", "Job"])
def test_pods_of_every_kind_are_tried(kind: str) -> None:
    """Pod Security judges those of a Job only when the Job makes them, which would then wait."""
    manifest = {**workload(), "kind": kind}
    [trial] = choose_trials([manifest], {}, [manifest])
    assert trial.workloads == (ref_of(manifest),)
    assert trial.pod["spec"] == manifest["spec"]["template"]["spec"]


def test_a_template_without_metadata_is_tried() -> None:
    """A Job's, which needs no label; nobody writes an empty one."""
    template = {"spec": workload()["spec"]["template"]["spec"]}
    job = {**workload(), "kind": "Job", "spec": {"template": template}}
    [trial] = choose_trials([job], {}, [job])
    assert trial.pod["metadata"]["labels"] == {}


def test_an_update_fits_where_its_predecessor_was(fake: Any, report: Any) -> None:
    """The dry run of the new pod says that the quota is exceeded: the old one ends before."""
    deploy(Desired(RELEASE, (workload(),)), fake, report=report)
    exceeded = refuse_pods('pods "talker-x" is forbidden: exceeded quota: small')
    fake.store.refuse = lambda live, dry_run: exceeded(live, dry_run) if dry_run else None
    newer = workload(image="r/app:2")
    newer["spec"]["strategy"] = {"type": "Recreate"}
    assert deploy(Desired(RELEASE, (newer,)), fake, report=report).number == 2


def test_all_missing_rights_are_one_list_before_any_write(fake: Any, report: Any) -> None:
    """Not one at a time, in the middle."""
    fake.store.rules = [DEPLOYMENTS]
    with pytest.raises(Forbidden) as caught:
        deploy(Desired(RELEASE, (workload(),)), fake, report=report)
    assert caught.value.details == (
        "namespaces: get",
        "pods: list, watch",
        "secrets: create, delete, list, patch",
        "deployments.apps: create, patch",
        "leases.coordination.k8s.io: create, delete, get, patch, update",
    )
    assert "rigel -n n rbac deployer" in (caught.value.hint or "")
    assert fake.writes == []


def test_a_namespace_to_come_needs_its_right(fake: Any, report: Any) -> None:
    del fake.objects[ObjectRef("v1", "Namespace", "", "n")]
    verbs = ["get", "list", "watch", "update", "patch", "delete"]
    fake.store.rules = [{"apiGroups": ["*"], "resources": ["*"], "verbs": verbs}]
    with pytest.raises(Forbidden) as caught:
        deploy(attrs.evolve(desired(config()), create_namespace=True), fake, report=report)
    assert "namespaces (in the whole cluster): create" in caught.value.details
    way, _, usual = (caught.value.hint or "").partition("; ")
    assert way == "have the namespace created: `kubectl create namespace n`"
    assert "rbac deployer" in usual, "create is missing in the namespace, too"


@pytest.mark.parametrize("remedies", [{"PersistentVolume": "another way"}, {}])
def test_a_role_is_no_remedy_for_a_right_in_the_whole_cluster(
    fake: Any, report: Any, remedies: dict[str, str]
) -> None:
    """The Role of `rigel rbac` lies in a namespace and would change nothing."""
    inside = ["namespaces", "secrets", "leases", "configmaps"]
    fake.store.rules = [{"apiGroups": ["*"], "resources": inside, "verbs": ["*"]}]
    wanted = Desired(RELEASE, (make("PersistentVolume", "v"), config()), remedies=remedies)
    with pytest.raises(Forbidden) as caught:
        deploy(wanted, fake, report=report)
    assert caught.value.details == (
        "persistentvolumes (in the whole cluster): create, list, patch",
    )
    other = "ask an administrator for a ClusterRole that grants them"
    assert caught.value.hint == remedies.get("PersistentVolume", other)


def test_a_refused_look_lists_all_missing_rights_too(
    fake: Any, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first request that is refused would name one right alone."""
    fake.store.rules = []
    wanted = Desired(RELEASE, (workload(),), remedies={"Deployment": "leave it out"})
    text = b'{"message": "User \\"a\\" cannot list resource \\"deployments\\""}'
    error = refusal(403, text, "list Deployments", context="c", server="s")
    monkeypatch.setattr(FakeCluster, "list", raising(error))
    with pytest.raises(Forbidden, match="right") as caught:
        deploy(wanted, fake, report=report)
    assert "deployments.apps: create, list, patch, watch" in caught.value.details
    assert caught.value.hint == "leave it out"


def test_rights_that_cannot_be_asked_for_are_not_missing(
    fake: Any, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster that does not say what we may do gets the deploy as it is."""
    monkeypatch.setattr(FakeCluster, "review", raising(ClusterError("no review")))
    assert deploy(Desired(RELEASE, (config("c"),)), fake, report=report).status == "good"


def test_what_an_incomplete_list_of_rights_lacks_is_asked_for(fake: Any, report: Any) -> None:
    """An authorizer that is not RBAC does not list its rules."""

    class Incomplete(type(fake)):  # type: ignore[misc]
        def review(self, api_version: str, kind: str, spec: Any) -> Any:
            if kind == "SelfSubjectRulesReview":
                return {"resourceRules": [], "incomplete": True}
            return super().review(api_version, kind, spec)

    assert deploy(desired(config()), Incomplete(fake.store), report=report).status == "good"


def test_a_deletion_needs_its_right_only_where_something_is_deleted(fake: Any, report: Any) -> None:
    """Who never renames a node needs no right to delete Deployments."""
    deploy(Desired(RELEASE, (config("c"), config("d"))), fake, report=report)
    fake.store.rules = [
        {"apiGroups": ["*"], "resources": ["*"], "verbs": ["get", "list", "create", "patch"]},
        {"apiGroups": ["*"], "resources": ["secrets", "leases"], "verbs": ["*"]},
    ]
    deploy(Desired(RELEASE, (config("c", k="1"), config("d"))), fake, report=report)
    with pytest.raises(Forbidden) as caught:
        deploy(Desired(RELEASE, (config("c", k="1"),)), fake, report=report)
    assert caught.value.details == ("configmaps: delete",)
