"""What tests may rely on of a cluster: the same promises of the fake and of a real API server.

A subclass brings the fixtures: `cluster`, a `namespace` of its own, and `other`, which writes to
the same cluster as the field manager `argo`. Nothing here needs a node: no pod has to run.
"""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rigel_k8s.errors import ConflictError, NotFoundError
from rigel_k8s.kube.failures import Conflict, Refusal
from rigel_k8s.kube.store import NOTHING, this_object, this_state
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.labelling import covers, find_owned_fields, managers, take_over

from .until import until

NOBODY = "00000000-0000-0000-0000-000000000000"


def config(namespace: str, name: str = "c", **data: str) -> dict[str, Any]:
    meta = {"name": name, "namespace": namespace, "labels": {"app": "x"}}
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": data}


def deployment(namespace: str, image: str = "nowhere.invalid/a:1", **spec: Any) -> dict[str, Any]:
    """Return a Deployment whose pods no node takes."""
    labels = {"app.kubernetes.io/name": "d"}
    pod = {"containers": [{"name": "one", "image": image}], "nodeSelector": {"no": "node"}}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {"name": "d", "namespace": namespace},
        "spec": {
            "selector": {"matchLabels": labels},
            "template": {"metadata": {"labels": labels}, "spec": pod},
            **spec,
        },
    }


def job(namespace: str, image: str = "nowhere.invalid/a:1") -> dict[str, Any]:
    """Return a Job without pods."""
    pod = {"containers": [{"name": "one", "image": image}], "restartPolicy": "Never"}
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": "j", "namespace": namespace},
        "spec": {"suspend": True, "template": {"metadata": {}, "spec": pod}},
    }


def version(live: dict[str, Any]) -> str:
    return str(live["metadata"]["resourceVersion"])


class ClusterContract:
    """Promises about objects."""

    def test_an_object_is_made_once(self, cluster: Any, namespace: str) -> None:
        ref = ref_of(config(namespace))
        assert cluster.get(ref) is None
        made = cluster.create(config(namespace, a="1"))
        assert made["metadata"]["uid"]
        assert cluster.get(ref)["data"] == {"a": "1"}
        with pytest.raises(ConflictError) as caught:
            cluster.create(config(namespace))
        assert (caught.value.status, caught.value.reason) == (409, "AlreadyExists")
        assert not caught.value.fields

    def test_an_object_made_anew_is_another_one(self, cluster: Any, namespace: str) -> None:
        ref = ref_of(config(namespace))
        first = cluster.create(config(namespace))
        assert cluster.delete(ref) is True
        assert cluster.delete(ref) is False
        second = cluster.create(config(namespace))
        assert first["metadata"]["uid"] != second["metadata"]["uid"]

    def test_every_change_has_its_version(self, cluster: Any, namespace: str) -> None:
        made = cluster.create(config(namespace, a="1"))
        patched = cluster.patch(ref_of(made), {"data": {"b": "2"}})
        assert version(made) != version(patched)
        assert patched["metadata"]["uid"] == made["metadata"]["uid"]
        assert patched["data"] == {"a": "1", "b": "2"}
        assert cluster.patch(ref_of(made), {"data": {"a": None}})["data"] == {"b": "2"}

    def test_a_stale_version_is_a_conflict(self, cluster: Any, namespace: str) -> None:
        made = cluster.create(config(namespace, a="1"))
        cluster.patch(ref_of(made), {"data": {"a": "2"}})
        with pytest.raises(ConflictError, match="modified"):
            cluster.replace({**made, "data": {"a": "3"}})
        stale = {"metadata": {"resourceVersion": version(made)}, "data": {"a": "3"}}
        with pytest.raises(ConflictError, match="modified"):
            cluster.patch(ref_of(made), stale)
        assert cluster.get(ref_of(made))["data"] == {"a": "2"}

    def test_a_replace_without_a_version_replaces(self, cluster: Any, namespace: str) -> None:
        made = cluster.create(config(namespace, a="1"))
        replaced = cluster.replace(config(namespace, b="2"))
        assert replaced["data"] == {"b": "2"}
        assert replaced["metadata"]["uid"] == made["metadata"]["uid"]

    def test_another_uid_is_refused(self, cluster: Any, namespace: str) -> None:
        """By a delete and a replace: the object that was meant is gone."""
        made = cluster.create(config(namespace, a="1"))
        with pytest.raises(ConflictError):
            cluster.delete(ref_of(made), uid=NOBODY)
        other = config(namespace, a="2")
        other["metadata"]["uid"] = NOBODY
        with pytest.raises(ConflictError):
            cluster.replace(other)
        assert cluster.get(ref_of(made))["data"] == {"a": "1"}
        assert cluster.delete(ref_of(made), uid=made["metadata"]["uid"]) is True

    def test_what_is_not_there_is_missing(self, cluster: Any, namespace: str) -> None:
        with pytest.raises(NotFoundError):
            cluster.patch(ref_of(config(namespace)), {"data": {"a": "1"}})
        with pytest.raises(NotFoundError):
            cluster.apply(config("nowhere-at-all"))
        with pytest.raises(NotFoundError):
            cluster.create(config("nowhere-at-all"))
        assert cluster.get(ref_of(config("nowhere-at-all"))) is None
        assert cluster.list("v1", "ConfigMap", "nowhere-at-all") == []
        robot = {**config(namespace), "apiVersion": "example.com/v1", "kind": "Robot"}
        assert not cluster.serves("example.com/v1", "Robot")
        with pytest.raises(NotFoundError, match="no kind Robot"):
            cluster.apply(robot)

    def test_lists_select(self, cluster: Any, namespace: str) -> None:
        cluster.create(config(namespace, "one", a="1"))
        other = config(namespace, "two")
        other["metadata"]["labels"] = {"app": "y"}
        cluster.create(other)

        def names(**selectors: Any) -> set[str]:
            found = cluster.list("v1", "ConfigMap", namespace, **selectors)
            return {live["metadata"]["name"] for live in found} - {"kube-root-ca.crt"}

        assert names() == {"one", "two"}
        assert names(labels={"app": "x"}) == names(labels="app=x") == {"one"}
        assert names(labels="app!=x") == {"two"}
        assert names(fields="metadata.name=two") == {"two"}
        [bare] = cluster.list("v1", "ConfigMap", namespace, labels="app=x", metadata_only=True)
        assert (bare["metadata"]["name"], bare.get("data")) == ("one", None)

    def test_a_watch_shows_what_is_there_and_what_happens(
        self, cluster: Any, namespace: str
    ) -> None:
        over, seen, listed = threading.Event(), list[Any](), list[int]()
        cluster.create(config(namespace))

        def follow() -> None:
            selected = {"labels": {"app": "x"}, "listed": lambda: listed.append(len(seen))}
            for event in cluster.watch("v1", "ConfigMap", namespace, cancel=over, **selected):
                seen.append((event.type, (event.object.get("data") or {}).get("a")))

        thread = threading.Thread(target=follow)
        thread.start()
        try:
            until(lambda: seen == [("ADDED", None)], "object that was there", 120)
            cluster.patch(ref_of(config(namespace)), {"data": {"a": "1"}})
            cluster.delete(ref_of(config(namespace)))
            until(lambda: len(seen) == 3, "change and end", 120)
        finally:
            over.set()
            thread.join(60)
        assert seen[1:] == [("MODIFIED", "1"), ("DELETED", "1")]
        assert listed == [1], "what was there has been seen by then"

    # Dry runs.

    def test_a_dry_run_changes_nothing(self, cluster: Any, namespace: str) -> None:
        ref = ref_of(config(namespace))
        assert cluster.apply(config(namespace, a="1"), dry_run=True)["data"] == {"a": "1"}
        assert cluster.create(config(namespace, a="1"), dry_run=True)["metadata"]["uid"]
        assert cluster.get(ref) is None
        made = cluster.create(config(namespace, a="1"))
        cluster.apply(config(namespace, a="2"), force=True, dry_run=True)
        assert cluster.get(ref) == made

    def test_a_dry_run_tells_whether_the_object_is_there(
        self, cluster: Any, namespace: str
    ) -> None:
        """By its resourceVersion: that is how a survey finds strangers with our names."""
        tried = cluster.apply(config(namespace, a="1"), dry_run=True)
        assert not tried["metadata"].get("resourceVersion")
        made = cluster.apply(config(namespace, a="1"))
        tried = cluster.apply(config(namespace, a="2"), dry_run=True)
        assert version(tried) == version(made)

    def test_a_dry_run_is_refused_what_the_apply_would_be(
        self, cluster: Any, other: Any, namespace: str
    ) -> None:
        other.apply(config(namespace, a="1"))
        for dry_run in (True, False):
            with pytest.raises(Conflict) as caught:
                cluster.apply(config(namespace, a="2"), dry_run=dry_run)
            assert [(f.manager, f.field) for f in caught.value.fields] == [("argo", ".data.a")]

    # Ownership.

    def test_an_apply_owns_what_it_says(self, cluster: Any, namespace: str) -> None:
        made = cluster.apply(config(namespace, a="1"))
        assert covers(config(namespace, a="1"), made)
        assert not covers(config(namespace, b="1"), made)
        assert managers(made) == ()

    def test_an_apply_that_changes_nothing_writes_nothing(
        self, cluster: Any, namespace: str
    ) -> None:
        first = cluster.apply(config(namespace, a="1"))
        assert version(cluster.apply(config(namespace, a="1"))) == version(first)

    def test_an_apply_onto_nothing_only_creates(self, cluster: Any, namespace: str) -> None:
        """Not even by force does it change what is there."""
        made = cluster.apply(config(namespace, a="1"), onto=NOTHING)
        assert made["data"] == {"a": "1"}
        for force in (False, True):
            with pytest.raises(ConflictError) as caught:
                cluster.apply(config(namespace, a="2"), onto=NOTHING, force=force)
            assert (caught.value.status, caught.value.fields) == (409, ())
        assert cluster.get(ref_of(made))["data"] == {"a": "1"}
        cluster.delete(ref_of(made))
        assert cluster.apply(config(namespace, a="2"), onto=NOTHING)["data"] == {"a": "2"}

    def test_of_two_applies_onto_nothing_one_creates(self, cluster: Any, namespace: str) -> None:
        """Though both write as one field manager."""
        for number in range(5):

            def create(said: str, name: str = f"c{number}") -> str:
                try:
                    cluster.apply(config(namespace, name, a=said), onto=NOTHING)
                except ConflictError:
                    return ""
                return said

            done = [said for said in cluster.parallel(create, "abcd") if said]
            ref = ref_of(config(namespace, f"c{number}"))
            assert [cluster.get(ref)["data"]["a"]] == done

    def test_an_apply_onto_an_object_changes_no_other(self, cluster: Any, namespace: str) -> None:
        """Neither one that was made anew nor, where its state counts, one that was changed."""
        first = cluster.apply(config(namespace, a="1"))
        second = cluster.apply(config(namespace, a="2"), onto=this_object(first))
        third = cluster.apply(config(namespace, a="3"), onto=this_state(second))
        with pytest.raises(ConflictError):
            cluster.apply(config(namespace, a="4"), onto=this_state(second), force=True)
        cluster.delete(ref_of(third))
        for gone in (this_object(third), this_state(third)):
            with pytest.raises(ConflictError):
                cluster.apply(config(namespace, a="4"), onto=gone)
        cluster.apply(config(namespace, a="5"))
        for gone in (this_object(third), this_state(third)):
            with pytest.raises(ConflictError):
                cluster.apply(config(namespace, a="6"), onto=gone, force=True)
        assert cluster.get(ref_of(third))["data"] == {"a": "5"}

    def test_what_is_said_no_more_goes_away(self, cluster: Any, other: Any, namespace: str) -> None:
        """Unless another manager says it too."""
        cluster.apply(config(namespace, a="1", b="1", c="1"))
        other.apply(config(namespace, b="1"))
        assert cluster.apply(config(namespace, a="1"))["data"] == {"a": "1", "b": "1"}

    def test_the_same_value_is_no_conflict(self, cluster: Any, other: Any, namespace: str) -> None:
        other.apply(config(namespace, a="1"))
        shared = cluster.apply(config(namespace, a="1", b="2"))
        assert managers(shared) == ("argo",)
        assert covers(config(namespace, a="1", b="2"), shared)

    def test_a_forced_apply_takes_over(self, cluster: Any, other: Any, namespace: str) -> None:
        other.apply(config(namespace, a="1", b="1"))
        live = cluster.apply(config(namespace, a="2"), force=True)
        assert live["data"] == {"a": "2", "b": "1"}
        with pytest.raises(Conflict):
            other.apply(config(namespace, a="3", b="1"))

    def test_an_edit_takes_fields_from_who_applied_them(
        self, cluster: Any, other: Any, namespace: str
    ) -> None:
        cluster.apply(config(namespace, a="1", b="1"))
        edited = other.patch(ref_of(config(namespace)), {"data": {"a": "2"}})
        assert covers(config(namespace, b="1"), edited)
        assert not covers(config(namespace, a="1", b="1"), edited)
        with pytest.raises(Conflict) as caught:
            cluster.apply(config(namespace, a="1", b="1"))
        assert [(f.manager, f.field) for f in caught.value.fields] == [("argo", ".data.a")]

    def test_ownership_can_be_written(self, cluster: Any, other: Any, namespace: str) -> None:
        """The way of --adopt: what others had set becomes ours, and goes when we do not say it."""
        theirs = other.apply(config(namespace, a="1", extra="theirs"))
        meta = {"managedFields": take_over(theirs), "resourceVersion": version(theirs)}
        live = cluster.patch(ref_of(theirs), {"metadata": meta})
        assert managers(live) == ()
        assert cluster.apply(config(namespace, a="1"))["data"] == {"a": "1"}

    def test_items_of_a_list_are_owned_one_by_one(
        self, cluster: Any, other: Any, namespace: str
    ) -> None:
        """Containers by their names: two tools may each have one."""
        ours = deployment(namespace, replicas=0)
        cluster.apply(ours)
        theirs = deployment(namespace, replicas=0)
        theirs["spec"]["template"]["spec"]["containers"] = [{"name": "two", "image": "b"}]
        live = other.apply(theirs)
        names = [c["name"] for c in live["spec"]["template"]["spec"]["containers"]]
        assert sorted(names) == ["one", "two"]
        assert covers(ours, live)
        theirs["spec"]["template"]["spec"]["containers"] = [{"name": "one", "image": "b"}]
        with pytest.raises(Conflict) as caught:
            other.apply(theirs)
        field = '.spec.template.spec.containers[name="one"].image'
        assert [(f.manager, f.field) for f in caught.value.fields] == [("rigel", field)]

    def test_defaults_belong_to_nobody(self, cluster: Any, other: Any, namespace: str) -> None:
        live = cluster.apply(deployment(namespace, replicas=0))
        assert live["spec"]["strategy"]["rollingUpdate"]["maxSurge"] == "25%"
        assert "f:strategy" not in find_owned_fields(live)["f:spec"]
        other.apply({**deployment(namespace), "spec": {**deployment(namespace)["spec"]}})

    # What is refused.

    def test_the_pods_of_a_job_never_change(self, cluster: Any, namespace: str) -> None:
        """What stays the same may be applied again; a suspended Job makes no pod."""
        made = cluster.apply(job(namespace))
        again = cluster.apply(job(namespace))
        assert (again["metadata"]["uid"], again["spec"]) == (made["metadata"]["uid"], made["spec"])
        own = made["spec"]["selector"]["matchLabels"].items()
        assert own <= made["spec"]["template"]["metadata"]["labels"].items()
        with pytest.raises(Refusal, match="field is immutable") as caught:
            cluster.apply(job(namespace, image="nowhere.invalid/a:2"), dry_run=True)
        assert caught.value.status == 422
        assert all("field is immutable" in one.message for one in caught.value.causes)

    def test_a_selector_never_changes(self, cluster: Any, namespace: str) -> None:
        cluster.apply(deployment(namespace, replicas=0))
        other = deployment(namespace, replicas=0)
        other["spec"]["selector"] = {"matchLabels": {"app": "z"}}
        other["spec"]["template"]["metadata"]["labels"] = {"app": "z"}
        with pytest.raises(Refusal, match="field is immutable") as caught:
            cluster.apply(other, force=True, dry_run=True)
        assert (caught.value.status, caught.value.reason) == (422, "Invalid")
        assert [c.field for c in caught.value.causes] == ["spec.selector"]

    def test_recreate_leaves_no_rolling_update(self, cluster: Any, namespace: str) -> None:
        """What Kubernetes had filled in stays, and is refused beside the new strategy."""
        ref = ref_of(deployment(namespace))
        cluster.apply(deployment(namespace, replicas=0))
        recreate = deployment(namespace, replicas=0, strategy={"type": "Recreate"})
        with pytest.raises(Refusal, match="rollingUpdate") as caught:
            cluster.apply(recreate)
        assert [c.field for c in caught.value.causes] == ["spec.strategy.rollingUpdate"]
        cluster.patch(ref, {"spec": {"strategy": {"type": "Recreate", "rollingUpdate": None}}})
        assert cluster.apply(recreate)["spec"]["strategy"] == {"type": "Recreate"}

    # Ends.

    def test_a_finalizer_holds_what_is_deleted(self, cluster: Any, namespace: str) -> None:
        held = config(namespace, a="1")
        held["metadata"]["finalizers"] = ["example.com/hold"]
        ref = ref_of(cluster.create(held))
        assert cluster.delete(ref) is True
        live = cluster.get(ref)
        assert live["metadata"]["deletionTimestamp"]
        with pytest.raises(ConflictError):
            cluster.create(config(namespace))
        cluster.patch(ref, {"metadata": {"finalizers": None}})
        assert cluster.get(ref) is None

    def test_a_namespace_that_ends_takes_nothing_new(self, cluster: Any, namespace: str) -> None:
        """And ends with all that was in it."""
        held = config(namespace, "held")
        held["metadata"]["finalizers"] = ["example.com/hold"]
        cluster.create(held)
        space = ObjectRef("v1", "Namespace", "", namespace)
        cluster.delete(space)
        with pytest.raises(Refusal, match="being terminated") as caught:
            cluster.create(config(namespace))
        assert caught.value.status == 403
        cluster.patch(ref_of(held), {"metadata": {"finalizers": None}})
        # A namespace stays while an API that is aggregated does not answer, as in other tests.
        until(lambda: cluster.get(space) is None, "end of the namespace", 300)
        assert cluster.get(ref_of(held)) is None

    # Controllers.

    def test_a_deployment_has_replica_sets_and_pods(self, cluster: Any, namespace: str) -> None:
        """As deploys read them: owners, revisions, the generation that was seen."""

        def there(kind: str, count: int) -> list[dict[str, Any]]:
            api = "apps/v1" if kind == "ReplicaSet" else "v1"
            found = until(
                lambda: (all := cluster.list(api, kind, namespace)) and len(all) == count and all,
                f"{count} of {kind}",
            )
            return sorted(
                found, key=lambda o: str(o["metadata"].get("annotations", {}).get(NUMBER))
            )

        made = cluster.apply(deployment(namespace, replicas=2))
        [one] = there("ReplicaSet", 1)
        assert owners(one) == [made["metadata"]["uid"]]
        assert one["metadata"]["annotations"][NUMBER] == "1"
        for pod in there("Pod", 2):
            assert owners(pod) == [one["metadata"]["uid"]]
            assert pod["metadata"]["labels"]["app.kubernetes.io/name"] == "d"
        changed = cluster.apply(deployment(namespace, "nowhere.invalid/a:2", replicas=2))
        assert changed["metadata"]["generation"] > made["metadata"]["generation"]
        one, two = there("ReplicaSet", 2)
        assert two["metadata"]["annotations"][NUMBER] == "2"

        def settled() -> bool:
            live = cluster.get(ref_of(made))
            status, meta = live["status"], live["metadata"]
            seen = status.get("observedGeneration") == changed["metadata"]["generation"]
            return bool(
                seen and meta["annotations"][NUMBER] == "2" and not status.get("readyReplicas")
            )

        until(settled, "sight of the new generation")
        cluster.delete(ref_of(made))
        until(
            lambda: (
                not cluster.list("v1", "Pod", namespace)
                and not cluster.list("apps/v1", "ReplicaSet", namespace)
            ),
            "end of what the Deployment had made",
        )


NUMBER = "deployment.kubernetes.io/revision"


def owners(live: dict[str, Any]) -> list[str]:
    return [ref["uid"] for ref in live["metadata"]["ownerReferences"] if ref["controller"]]
