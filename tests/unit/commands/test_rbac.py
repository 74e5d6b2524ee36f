"""Roles that `rigel rbac` prints."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from rigel_k8s.cli.main import cli
from rigel_k8s.commands.rbac import account
from rigel_k8s.errors import UserError
from rigel_k8s.objects.rights import find_missing, grant, make_rules
from rigel_k8s.observability.options import StackRequest
from rigel_k8s.release.refusals.missing import find_resource, need_for
from rigel_multus.installation import Installation
from rigel_multus.manifests import network_release
from rigel_multus.platform import Group, platform
from rigel_stack.install import render_stack
from tests.support.fake_cluster import FakeCluster


def call(*words: str) -> list[Any]:
    done = CliRunner().invoke(cli, [*words], standalone_mode=False, obj={})
    assert done.exception is None, done.exception
    return list(yaml.safe_load_all(done.stdout))


def test_a_role_is_printed_with_a_binding_for_each_subject() -> None:
    """Bindings have names of their own, so that a later user does not replace an earlier one."""
    words = ["--user", "ada@lab", "--group", "lab/robots", "--serviceaccount", "ci:bot"]
    role, *bindings = call("-n", "robots", "rbac", "deployer", *words)
    assert (role["kind"], role["metadata"]["name"]) == ("Role", "rigel-deployer")
    assert [b["metadata"]["name"] for b in bindings] == [
        "rigel-deployer:user:ada@lab",
        "rigel-deployer:group:lab-robots",
        "rigel-deployer:serviceaccount:ci:bot",
    ]
    assert {item["metadata"]["namespace"] for item in (role, *bindings)} == {"robots"}
    assert [b["subjects"][0]["name"] for b in bindings] == ["ada@lab", "lab/robots", "bot"]
    assert all(b["roleRef"]["name"] == "rigel-deployer" for b in bindings)


@pytest.mark.parametrize(
    ("labels", "warned"),
    [({}, True), ({"pod-security.kubernetes.io/enforce": "baseline"}, False), (None, False)],
)
def test_a_namespace_without_pod_security_is_a_warning(
    labels: dict[str, str] | None, *, warned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its deployers can be root on machines; a namespace that does not exist says nothing."""
    fake = FakeCluster()
    if labels is not None:
        meta = {"name": "robots", "labels": labels}
        fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
    monkeypatch.setattr("rigel_k8s.kube.connect", lambda settings: fake)
    done = CliRunner().invoke(cli, ["-n", "robots", "rbac", "deployer"])
    assert ("does not enforce Pod Security" in done.stderr) is warned
    assert "Role" in done.stdout


def test_the_namespace_may_stand_after_the_command() -> None:
    """As with kubectl; it wins over the global option."""
    [role] = call("-n", "other", "rbac", "viewer", "-n", "robots")
    assert role["metadata"] == {"name": "rigel-viewer", "namespace": "robots"}


#: What an installer needs beside the installed objects and the rights of their programs.
BESIDE = (
    ("", "namespaces", "get create patch"),
    ("", "secrets", "get list create patch delete"),  # revisions, and Grafana's password
    ("coordination.k8s.io", "leases", "get create update patch delete"),
    ("", "pods", "list watch create delete"),  # some prove that each machine attaches pods
    ("", "pods/exec", "get create"),
    ("k8s.cni.cncf.io", "network-attachment-definitions", "list create delete"),
    ("", "nodes", "get list"),
    ("storage.k8s.io", "storageclasses", "list"),
    ("", "services/proxy", "get"),  # `rigel observe status` asks the stack
    ("discovery.k8s.io", "endpointslices", "list"),
    ("", "pods/log", "get"),  # why something is not ready
    ("", "events", "list watch"),
    ("apps", "replicasets", "list watch"),
    ("", "persistentvolumeclaims", "list"),
    ("apps", "daemonsets deployments statefulsets", "list"),
    ("batch", "jobs", "list"),
)


def test_an_installer_may_write_all_that_is_installed_and_grant_its_rights() -> None:
    """Kubernetes lets no one grant a right that they do not have; nothing more is granted."""
    [role] = call("rbac", "installer")
    assert role["kind"] == "ClusterRole"
    network = network_release(Installation([Group(platform("plain"))]), "")
    made = [*network.objects, *render_stack(StackRequest({})).desired.objects]
    assert find_missing(need_for(made, made, made, "kube-system"), role["rules"]) == []
    needed = {right for words in BESIDE for right in grant(*words)}
    for item in made:
        if resource := find_resource(item["apiVersion"], item["kind"]):
            group = item["apiVersion"].rpartition("/")[0]
            needed.update(grant(group, resource.plural, "get list watch create patch delete"))
        for rule in item.get("rules") or []:
            for group in rule["apiGroups"]:
                needed.update(grant(group, " ".join(rule["resources"]), " ".join(rule["verbs"])))
    assert role["rules"] == make_rules(needed)


@pytest.mark.parametrize("text", ["bot", ":bot", "ci:", ""])
def test_a_service_account_has_a_namespace(text: str) -> None:
    """The error shows the form."""
    with pytest.raises(UserError) as caught:
        account(text)
    assert "NAMESPACE:NAME" in (caught.value.hint or "")
