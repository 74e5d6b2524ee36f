"""The stack without a cluster: what several applications make of it, and what it costs a robot."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from typing import Any

import attrs
import pytest

from rigel_k8s.deploy import deploy
from rigel_k8s.errors import RolloutFailed, UserError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.observability.options import ObservabilityOptions, request_of
from rigel_k8s.observability.reading.stack import find_namespace
from rigel_k8s.release.types import DeployOptions, ReleaseId, Revision
from rigel_k8s.settings import Application, Settings
from rigel_stack import install as observability_install
from rigel_stack.install import (
    api_servers,
    desired_stack,
    find_missing_operator,
    find_positions,
    gives_storage,
    render_stack,
    requested_stack,
    stack_part,
    warn_of_lost_data,
)
from rigel_stack.job import ObservabilityJob
from rigel_stack.password import ensure_administrator
from tests.support.controllers import Controllers, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder

NOETIC = Application(distro="noetic")


class Cluster:
    """The few answers that looking takes; what is written is kept."""

    uid = "0a1b2c3d-0000-0000-0000-000000000000"

    def __init__(self, *objects: Mapping[str, Any], served: tuple[str, ...] = ()) -> None:
        self.objects, self.served = list(objects), served
        self.secret: dict[str, Any] | None = None
        self.deleted: list[Any] = []
        self.patches = 0

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""

    def list(self, api: str, kind: str, *_: Any, **__: Any) -> list[Mapping[str, Any]]:
        return [one for one in self.objects if one["kind"] == kind]

    def nodes(self) -> list[Mapping[str, Any]]:
        return self.list("v1", "Node")

    def serves(self, api: str, kind: str) -> bool:
        return kind in self.served

    def get(self, ref: Any) -> Any:
        found = {"metadata": {"name": ref.name, "uid": self.uid}}
        return self.secret if ref.kind == "Secret" else found

    def create(self, manifest: dict[str, Any]) -> None:
        self.secret = manifest

    def patch(self, ref: Any, body: Any) -> None:
        assert self.secret is not None
        self.patches += 1
        self.secret["data"] |= body["data"]

    def delete(self, ref: Any) -> None:
        self.deleted.append(ref)

    def password(self) -> str:
        assert self.secret is not None
        return base64.b64decode(self.secret["data"]["admin-password"]).decode()


def role(namespace: str) -> dict[str, Any]:
    annotations = {"rigel-k8s/namespace": namespace}
    return {"kind": "ClusterRole", "metadata": {"name": "r", "annotations": annotations}}


def revision(options: Mapping[str, Any]) -> Revision:
    release = ReleaseId("monitoring", "rigel-observability")
    return Revision(release, 3, "good", "", (), (), options)


@pytest.fixture
def last(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The options of the last revision; none where it stays empty."""
    options: dict[str, Any] = {}

    def found(cluster: Any, release: ReleaseId) -> Revision | None:
        return revision(options) if options else None

    monkeypatch.setattr(observability_install, "find_last_good", found)
    return options


def asked(raw: Mapping[str, Any], *objects: Any) -> Any:
    cluster: Any = Cluster(*objects)
    return desired_stack(request_of(raw), cluster)


def job(raw: Mapping[str, Any] | None = None) -> JobContext:
    return JobContext("job", NOETIC, Recorder(), Settings(), raw=raw or {})


def test_what_one_application_does_not_say_stays_as_another_said_it(last: dict[str, Any]) -> None:
    """Lists and single values are replaced, and nothing is reset by silence."""
    last |= {"loki": {"retention": "30d"}, "grafana": {"enabled": False}, "collector": "promtail"}
    found = asked({"enabled": True, "loki": {"service_type": "NodePort"}})
    options = found.stack.options
    assert (options.loki.retention, options.loki.service_type) == ("30d", "NodePort")
    assert (found.stack.has_grafana, found.stack.collector) == (False, "promtail")
    assert found.desired.options == {
        "loki": {"retention": "30d", "service_type": "NodePort"},
        "grafana": {"enabled": False},
        "collector": "promtail",
    }


def test_what_is_one_applications_own_is_not_the_stacks(last: dict[str, Any]) -> None:
    """Its exporter, its switch, and a password, which stands in no revision."""
    raw = {
        "enabled": True,
        "namespace": "watch",
        "ros_metrics": {"topics": ["/scan"]},
        "grafana": {"admin_password": "secret", "default_dashboards": False},
    }
    assert request_of(raw).options == {"grafana": {"default_dashboards": False}}
    assert asked(raw).desired.options == {"grafana": {"default_dashboards": False}}


def test_what_two_applications_say_together_may_be_wrong(last: dict[str, Any]) -> None:
    """Each was right by itself: the message says so."""
    last |= {"existing": {"prometheus": True}, "grafana": {"enabled": False}}
    with pytest.raises(UserError, match="contradict those of earlier ones") as told:
        asked({"enabled": True, "grafana": {"enabled": True}})
    assert "existing.prometheus" in told.value.details[0]


def test_the_stack_is_where_it_is(last: dict[str, Any]) -> None:
    """A second one is refused, with the namespace of the first."""
    assert asked({}, role("watch")).stack.namespace == "watch"
    assert asked({"namespace": "watch"}, role("watch")).stack.namespace == "watch"
    assert asked({"namespace": "watch"}).stack.namespace == "watch"
    assert asked({}).stack.namespace == "monitoring"
    with pytest.raises(UserError, match="already has an observability stack"):
        asked({"namespace": "other"}, role("watch"))


@pytest.mark.parametrize("name", ["otel-collector", "promtail"])
def test_a_collector_shares_no_directory_with_another_cluster(
    name: str, last: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays where it was: there is how far it has read, and lines that wait."""
    request, default = {"collector": name}, f"/var/lib/rigel-{name}"

    def look(made: Any) -> Any:
        return [(who, there["path"]) for who, there in find_positions(made.desired.objects)]

    assert look(render_stack(request_of(request))) == [(name, default)]
    new = asked(request)
    assert look(new) == [(name, f"{default}/0a1b2c3d")]
    for earlier in (default, f"{default}/elsewhere"):
        text = json.dumps(new.desired.objects).replace(f"{default}/0a1b2c3d", earlier)
        kept = attrs.evolve(revision(request), objects=tuple(json.loads(text)))
        monkeypatch.setattr(observability_install, "find_last_good", lambda *_, kept=kept: kept)
        assert look(asked(request)) == [(name, earlier)]


def test_storage_and_api_servers_are_looked_for() -> None:
    """A default class gives claims; a tunnel's address counts as the API server's."""
    note = {"storageclass.kubernetes.io/is-default-class": "true"}
    storage = {"kind": "StorageClass", "metadata": {"annotations": note}}
    other = {"kind": "StorageClass", "metadata": {}}
    ends = {"kind": "EndpointSlice", "metadata": {}, "endpoints": [{"addresses": ["10.0.0.1"]}]}
    addresses = [{"type": "InternalIP", "address": "10.0.0.1"}]
    server = {
        "kind": "Node",
        "metadata": {"name": "server"},
        "spec": {"podCIDR": "10.42.0.0/24"},
        "status": {"addresses": addresses},
    }
    robot = {**server, "spec": {"podCIDR": "10.42.1.0/24"}, "status": {"addresses": []}}
    cluster: Any = Cluster(storage, other, ends, server, robot)
    assert gives_storage(cluster)
    assert not gives_storage(Cluster(other))  # type: ignore[arg-type]
    assert api_servers(cluster) == ("10.0.0.1", "10.42.0.0")
    assert find_namespace(cluster) is None


def test_without_an_operator_the_way_out_is_told() -> None:
    cluster: Any = Cluster(served=("PodMonitor",))
    [error] = find_missing_operator(cluster)
    assert "has no kind PrometheusRule" in error.message
    assert "install the operator first" in str(error.hint)


def test_who_may_only_deploy_applications_does_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stack is an administrator's: its job fails without the rights, theirs goes on."""
    refusals = iter([Forbidden("forbidden"), Forbidden("forbidden"), Refusal("away")])

    def look(*_: Any) -> Any:
        raise next(refusals)

    monkeypatch.setattr(observability_install, "desired_stack", look)
    report, cluster = Recorder(), Cluster()
    with pytest.raises(Forbidden) as told:
        stack_part(request_of({}), cluster)  # type: ignore[arg-type]
    assert "administrator" in str(told.value.hint)
    assert requested_stack(request_of({}), cluster, report) == []  # type: ignore[arg-type]
    assert "stays as it is; let an administrator" in report.warnings[0]
    with pytest.raises(Refusal, match="away"):
        requested_stack(request_of({}), cluster, report)  # type: ignore[arg-type]


def test_a_password_is_random_and_made_once() -> None:
    """Long enough, and not another one with every deploy."""
    first, second = Cluster(), Cluster()
    for cluster in (first, second, first):
        ensure_administrator(cluster, "monitoring", None)  # type: ignore[arg-type]
    assert first.password() != second.password()
    assert len(first.password()) >= 24
    assert first.patches == 0


def test_a_password_that_is_told_counts() -> None:
    """A changed one too: Grafana is started anew, since it reads it at its start."""
    pod = {"kind": "Pod", "metadata": {"name": "grafana-1"}}
    cluster: Any = Cluster(pod)
    ensure_administrator(cluster, "monitoring", "first")
    assert (cluster.password(), cluster.deleted) == ("first", [])
    ensure_administrator(cluster, "monitoring", "second")
    assert cluster.password() == "second"
    assert [ref.name for ref in cluster.deleted] == ["grafana-1"]
    ensure_administrator(cluster, "monitoring", None)
    assert cluster.password() == "second"


def test_no_render_has_a_password() -> None:
    """Neither the Secret nor the Rigelfile's own word."""
    made = render_stack(request_of({"grafana": {"admin_password": "hunter2"}}))
    assert "hunter2" not in str(made.desired)
    assert {item["kind"] for item in made.desired.objects}.isdisjoint({"Secret"})


def test_data_that_nobody_keeps_are_told_of(
    last: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster without a default StorageClass loses them with the pod."""
    found = asked({"enabled": True, "prometheus": {"persistence": {"enabled": False}}})
    assert [warning.split()[0] for warning in warn_of_lost_data(found.stack)] == ["loki"]


def test_the_job_that_is_switched_off_does_nothing() -> None:
    """`enabled: false` is what it says."""
    context = job()
    ObservabilityJob().run(ObservabilityOptions(enabled=False), context)
    assert context.report.lines == ["observability.enabled is false: nothing to do"]  # type: ignore[attr-defined]


def test_one_stack_at_a_time() -> None:
    """Two branches of a sequence must not change it at once."""
    exclusive = ObservabilityJob().exclusive
    keys = {exclusive(ObservabilityOptions(), NOETIC, Settings(namespace=n)) for n in ("a", "b")}
    assert len(keys) == 1


@pytest.fixture
def install(fake: FakeCluster, report: Recorder) -> Callable[..., None]:
    """Install the stack on the fake: install({...}, own=False)."""

    def call(raw: Mapping[str, Any], *, own: bool = True, timeout: float = 5) -> None:
        options = DeployOptions(report=report, timeout=timeout)
        deploy([stack_part(request_of(raw), fake, own=own)], fake, options)

    return call


WITHOUT_GRAFANA = {"enabled": True, "grafana": {"enabled": False}}


def test_a_stack_that_is_there_costs_no_wait(
    install: Any, fake: FakeCluster, report: Recorder
) -> None:
    """Though a machine is away whose collector nobody can wait for."""
    install(WITHOUT_GRAFANA)
    assert report.lines[-1].endswith("is at revision 1")
    fake.create({"apiVersion": "v1", "kind": "Node", "metadata": {"name": "robot"}, "spec": {}})
    fake.store.controllers = Controllers(unready)
    fake.calls.clear()
    install(WITHOUT_GRAFANA, own=False)
    assert fake.writes == []
    assert not any("robot" in warning for warning in report.warnings)
    with pytest.raises(RolloutFailed):
        install({"loki": {"retention": "3d"}}, timeout=0.2)
    assert "machine robot is not ready: the installation does not wait for it" in report.warnings


def test_the_secret_that_it_makes_itself_is_not_missing(install: Any, report: Recorder) -> None:
    """Grafana's administrator, at the first deploy."""
    install({"enabled": True})
    assert not any("does not exist" in warning for warning in report.warnings)


def test_an_application_goes_on_without_its_stack(
    install: Any, fake: FakeCluster, report: Recorder
) -> None:
    """That it does not become ready is a warning with the cause."""
    fake.store.controllers = Controllers(unready)
    install(WITHOUT_GRAFANA, own=False, timeout=0.2)
    [warning] = [text for text in report.warnings if "not ready within" in text]
    assert "everything else is deployed" in warning
