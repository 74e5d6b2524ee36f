"""Roles that `rigel rbac` prints."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from rigel_k8s.cli.main import cli
from rigel_k8s.commands.installing import list_manifests, list_rules
from rigel_k8s.commands.rbac import account
from rigel_k8s.errors import UserError
from rigel_k8s.objects.rights import find_missing, grant
from rigel_k8s.release.refusals.rights import need_for
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


def test_an_installer_may_write_all_that_is_installed_and_grant_its_rights() -> None:
    """Kubernetes lets no one grant a right that they do not have."""
    [role] = call("rbac", "installer")
    assert role["kind"] == "ClusterRole"
    assert role["rules"] == list(list_rules())
    made = list_manifests()
    assert find_missing(need_for(made, made, made, "kube-system"), role["rules"]) == []
    granted = [rule for item in made for rule in item.get("rules") or []]
    assert granted
    for rule in granted:
        for group in rule.get("apiGroups") or []:
            rights = [*grant(group, " ".join(rule["resources"]), " ".join(rule["verbs"]))]
            assert find_missing(rights, role["rules"]) == []
        if rule.get("nonResourceURLs"):
            assert rule in role["rules"]


@pytest.mark.parametrize("text", ["bot", ":bot", "ci:", ""])
def test_a_service_account_has_a_namespace(text: str) -> None:
    """The error shows the form."""
    with pytest.raises(UserError) as caught:
        account(text)
    assert "NAMESPACE:NAME" in (caught.value.hint or "")
