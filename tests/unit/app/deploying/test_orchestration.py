"""The orchestration job, up to what it wants on the cluster."""

from __future__ import annotations

import base64
import io
import json
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.app.deploying.images import pin, secret_of, write_pull_secret
from rigel_k8s.app.deploying.prepare import Preparation, Request, prepare, timeout_of
from rigel_k8s.app.deploying.results import extract, find_newest_pod
from rigel_k8s.app.deploying.target import release_of
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import revisions
from rigel_k8s.release.types import Desired, ReleaseId, Revision
from rigel_k8s.settings import Application, Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.options import options
from tests.support.tag_registry import DIGEST, serve_tags

NOETIC = Application("noetic")
OTHER = "sha256:" + "cd" * 32


class Cluster:
    """A cluster that knows its namespace; nothing else may be asked of it."""

    namespace = "from-context"
    has_secret = False

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        return {} if ref.kind == "Secret" and self.has_secret else None


def make(
    raw: Mapping[str, Any], settings: Settings | None = None, cluster: object = None, **more: Any
) -> Preparation:
    """Return what a job of these options wants."""
    inner = raw.get("orchestration", raw)
    request = Request(
        options=options(inner),
        raw=raw,
        settings=settings or Settings(),
        **{"application": NOETIC, **more},
    )
    return prepare(request, cluster or Cluster())  # type: ignore[arg-type]


def image_of(raw: Mapping[str, Any], name: str, **more: Any) -> str:
    """Return the image of a Deployment that a job wants."""
    made_of = make(raw, **more)
    found = [m for m in made_of.desired.objects if m["kind"] == "Deployment"]
    named = {m["metadata"]["name"]: m["spec"]["template"]["spec"]["containers"][0] for m in found}
    return str(named[name]["image"])


@pytest.fixture
def revision(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The options and objects of the release's last revision, to be filled in by the test."""
    kept: dict[str, Any] = {"options": {}, "objects": ()}

    def last_good(cluster: object, release: ReleaseId) -> Revision | None:
        if not kept["options"] and not kept["objects"]:
            return None
        return Revision(release, 3, "good", "", kept["objects"], (), kept["options"])

    monkeypatch.setattr(revisions, "find_last_good", last_good)
    return kept


# Namespaces


@pytest.mark.parametrize(
    ("given", "raw", "namespace", "create"),
    [
        ("flag", {"namespace": "file"}, "flag", False),
        ("file", {"namespace": "file"}, "file", True),
        (None, {"namespace": "file"}, "file", True),
        (None, {}, "from-context", False),
    ],
)
def test_the_namespace_is_the_flags_the_files_or_the_contexts(
    given: str | None, raw: dict[str, Any], namespace: str, *, create: bool, revision: object
) -> None:
    """And only the one that the Rigelfile names is created."""
    raw = {"application_image": "localhost:1/a", **raw}
    settings = Settings(namespace=given)
    found = make(raw, settings).desired
    assert found.release == ReleaseId(namespace, "rigel-k8s-application")
    assert found.create_namespace is create


def test_without_any_cluster_the_namespace_is_default(tmp_path: Path) -> None:
    """`render` works where no kubeconfig is."""
    settings = Settings(kubeconfig=tmp_path / "none")
    assert release_of(options({}), settings).namespace == "default"


def test_two_branches_cannot_deploy_one_release() -> None:
    """The key names the release; another namespace is another release."""
    job = OrchestrationJob()
    one = job.exclusive(options({"namespace": "a"}), NOETIC, Settings())
    assert one == job.exclusive(options({"namespace": "b"}), NOETIC, Settings(namespace="a"))
    assert one != job.exclusive(options({"namespace": "b"}), NOETIC, Settings())


# Partial jobs


def test_a_partial_job_keeps_what_it_does_not_name(revision: dict[str, Any]) -> None:
    """src.plugin's update_k8s names no image, and resets none."""
    revision["options"] = {"application_image": "localhost:1/app:1", "deploy_ros_master": False}
    raw = {"orchestration": {"rolling_update": {"strategy": "Recreate"}}}
    found = make(raw).desired
    assert [m["kind"] for m in found.objects] == ["ConfigMap", "Deployment"]
    assert found.options == {**revision["options"], "rolling_update": {"strategy": "Recreate"}}


def test_a_part_of_nothing_is_refused(revision: object) -> None:
    """Deploying a default image instead would surprise."""
    raw = {"readiness": {"command": "x"}}
    with pytest.raises(UserError, match="describes a part of a release"):
        make(raw)


def test_a_part_that_does_not_fit_is_refused(revision: dict[str, Any]) -> None:
    """What the two make together is checked like any job."""
    volumes = {"volumes": [{"name": "v"}, {"name": "v"}]}
    revision["options"] = {"application_image": "localhost:1/a", "persistent_storage": volumes}
    raw = {"readiness": {"command": "x"}}
    with pytest.raises(UserError, match="part of revision 3, but does not fit it") as caught:
        make(raw)
    assert caught.value.details == (
        'persistent_storage.volumes.1.name: the volume "v" already exists [name-taken]',
    )


# Digests


@pytest.fixture
def registry() -> Iterator[str]:
    """HOST:PORT of a registry that answers."""
    with serve_tags() as server:
        yield server.host


def test_digests_come_from_this_runs_push_first(registry: str, revision: object) -> None:
    """What was just pushed is what is meant, whatever a registry's cache says."""
    data = {"image_digests": {f"{registry}/app:1": OTHER}}
    image = image_of({"application_image": f"{registry}/app:1"}, "rigel-k8s-application", data=data)
    assert image == f"{registry}/app:1@{OTHER}"


def test_a_tag_and_its_short_form_are_one_image() -> None:
    """`app` is `docker.io/library/app:latest`, however it was pushed."""
    data = {"image_digests": {"docker.io/team/app:latest": DIGEST}}
    assert pin(["team/app"], data, [], lambda: ()).by_digest == {"team/app": f"team/app@{DIGEST}"}


def test_digests_come_from_the_registry(registry: str, revision: object) -> None:
    """The same tag built again elsewhere rolls out too."""
    image = image_of({"application_image": f"{registry}/app:1"}, "rigel-k8s-application")
    assert image == f"{registry}/app:1@{DIGEST}"


def test_a_silent_registry_leaves_the_last_revisions_digest(
    registry: str, revision: dict[str, Any]
) -> None:
    """A registry that is down must not change what runs; a new tag stays a tag."""
    name = f"{registry}/app"
    spec = {"template": {"spec": {"containers": [{"image": f"{name}:2@{OTHER}"}]}}}
    revision["objects"] = ({"kind": "Deployment", "metadata": {"name": "x"}, "spec": spec},)
    raw = {"nodes": {"a": {"image": f"{name}:2"}, "b": {"image": f"{name}:3"}}}
    assert image_of(raw, "a") == f"{name}:2@{OTHER}"
    assert image_of(raw, "b") == f"{name}:3"


def test_an_image_with_a_digest_stays() -> None:
    """Nobody is asked."""
    assert pin([f"a@{DIGEST}"], {}, [], lambda: pytest.fail("asked")).by_digest == {}


# Credentials


def test_credentials_of_the_images_registries_become_a_pull_secret(revision: object) -> None:
    """Pods name it; its content is in no object of the release."""
    raw = {"application_image": "localhost:1/app", "deploy_ros_master": False}
    providers = {
        "here": RegistryCredentials("localhost:1", "me", "pa55word"),
        "elsewhere": RegistryCredentials("ghcr.io", "you", "concealed"),
        "ssh": object(),
    }
    found = make(raw, providers=providers)
    assert [c.username for c in found.credentials] == ["me"]
    spec = found.desired.objects[-1]["spec"]["template"]["spec"]
    assert spec["imagePullSecrets"] == [{"name": "rigel-k8s-application-registry"}]
    assert "pa55word" not in json.dumps([found.desired.objects, found.desired.options])
    secret = secret_of(found.desired.release, found.credentials)
    config = json.loads(base64.b64decode(secret["data"][".dockerconfigjson"]))
    auth = base64.b64decode(config["auths"]["localhost:1"]["auth"]).decode()
    assert auth == "me:pa55word"


def test_without_credentials_there_is_no_secret(revision: object) -> None:
    """A name of a Secret that is not there would be a warning on every pod."""
    raw = {"application_image": "localhost:1/app"}
    found = make(raw).desired
    assert "imagePullSecrets" not in json.dumps(found.objects)


def test_an_unconnected_provider_takes_no_secret_away(revision: object) -> None:
    """`diff` connects no provider, and must not show what `run` would not do."""
    raw = {"application_image": "localhost:1/app"}
    cluster = Cluster()
    cluster.has_secret = True
    found = make(raw, cluster=cluster)
    assert "rigel-k8s-application-registry" in json.dumps(found.desired.objects)
    found = make(raw, cluster=cluster, providers={})
    assert "imagePullSecrets" not in json.dumps(found.desired.objects)


def test_an_unchanged_pull_secret_is_not_written(fake: FakeCluster) -> None:
    """And a changed one is, in a namespace that may have to be made first."""
    wanted = Desired(ReleaseId("robots", "demo"), (), create_namespace=True)
    for password, writes in (("one", 2), ("one", 0), ("two", 1)):
        fake.calls.clear()
        me = [RegistryCredentials("localhost:1", "me", password)]
        write_pull_secret(wanted, me, fake)  # type: ignore[arg-type]
        assert len(fake.writes) == writes
    fake.calls.clear()
    write_pull_secret(wanted, [], fake)  # type: ignore[arg-type]
    assert fake.calls == []


# Timeouts


@pytest.mark.parametrize(
    ("raw", "given", "seconds"),
    [
        ({}, None, None),
        ({"timeout": "2m"}, 7.0, 7.0),
        ({"timeout": "2m", "readiness": {"timeout_seconds": 9}}, None, 120.0),
        ({"readiness": {"command": "a", "timeout_seconds": 9}}, None, 9.0),
        ({"nodes": {"a": {"readiness": {"timeout_seconds": 9}}}}, None, None),
        ({"nodes": {"a": {"readiness": {"timeout_seconds": 900}}}}, None, 900.0),
    ],
)
def test_who_bounds_the_roll_out(raw: dict[str, Any], given: float | None, seconds: float) -> None:
    """The flag, the job, src.plugin's readiness.timeout_seconds; a node only gives more time."""
    assert timeout_of(options(raw), Settings(timeout=given)) == seconds


# Parameter files


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file or directory"),
        ("a: [", "is not YAML"),
        ("- a\n", "is not a mapping"),
    ],
)
def test_a_parameter_file_is_looked_at_before_anything_is_sent(
    content: str | None, message: str, tmp_path: Path
) -> None:
    """Otherwise the node would try to load it for ever."""
    if content is not None:
        (tmp_path / "p.yaml").write_text(content)
    raw = {"nodes": {"a": {"image": "localhost:1/a", "args": "x", "parameter_files": ["p.yaml"]}}}
    settings = Settings(rigelfile=tmp_path / "Rigelfile")
    with pytest.raises(UserError, match=f"nodes.a.parameter_files: .*{message}"):
        make(raw, settings, application=Application("noetic", tmp_path))


# Results


def archive(**files: str) -> io.BytesIO:
    """Return a tar archive."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as opened:
        for name, text in files.items():
            info = tarfile.TarInfo(name.replace("__", "/").replace("UP", ".."))
            info.size = len(text)
            opened.addfile(info, io.BytesIO(text.encode()))
    stream.seek(0)
    return stream


def test_results_come_from_the_newest_pod_that_is_ready_and_stays(fake: FakeCluster) -> None:
    release = ReleaseId("n", "demo")
    with pytest.raises(RigelK8sError, match="no pod of demo in n is ready"):
        find_newest_pod(release, fake)  # type: ignore[arg-type]
    fake.store.controllers = None
    labels = {"app.kubernetes.io/name": "demo", "rigel-k8s/release": "demo"}
    pods = {"old": "True", "new": "True", "late": "False", "ending": "True"}
    for second, (name, ready) in enumerate(pods.items()):
        meta: dict[str, Any] = {"name": name, "namespace": "n", "labels": labels}
        meta["creationTimestamp"] = f"2026-01-01T00:00:0{second}Z"
        if name == "ending":
            meta |= {"deletionTimestamp": "2026-01-01T00:00:09Z", "finalizers": ["x/hold"]}
        status = {"conditions": [{"type": "Ready", "status": ready}]}
        fake.create({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "status": status})
    assert find_newest_pod(release, fake) == "new"  # type: ignore[arg-type]


@pytest.fixture(params=["new", "old"])
def unpacking(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python with its own filter of archives, and one without, such as Debian 12's."""
    if request.param == "old":
        monkeypatch.delattr(tarfile, "data_filter", raising=False)


@pytest.mark.usefixtures("unpacking")
def test_results_are_unpacked_into_their_directory(tmp_path: Path) -> None:
    """It is made where it is missing."""
    extract(archive(data__one="1"), tmp_path / "results")
    assert (tmp_path / "results" / "data" / "one").read_text() == "1"


@pytest.mark.usefixtures("unpacking")
def test_a_pod_cannot_write_outside_the_results(tmp_path: Path) -> None:
    """What comes out of a container is not trusted."""
    with pytest.raises(RigelK8sError, match="cannot unpack"):
        extract(archive(UP__evil="1"), tmp_path / "results")
    assert not (tmp_path / "evil").exists()
    link = io.BytesIO()
    with tarfile.open(fileobj=link, mode="w") as made:
        member = tarfile.TarInfo("out")
        member.type, member.linkname = tarfile.SYMTYPE, str(tmp_path)
        made.addfile(member)
    link.seek(0)
    with pytest.raises(RigelK8sError, match="cannot unpack"):
        extract(link, tmp_path / "results")


def test_a_cut_archive_is_told(tmp_path: Path) -> None:
    """As it is when the pod ends meanwhile."""
    with pytest.raises(RigelK8sError, match="cannot unpack"):
        extract(io.BytesIO(archive(one="1" * 2000).getvalue()[:700]), tmp_path)
