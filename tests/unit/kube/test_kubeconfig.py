"""Which cluster is meant, read as kubectl reads it."""

from __future__ import annotations

import base64
import json
import os
import sys
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from traceback import format_exception
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.kubeconfig import load


def write(path: Path, **content: Any) -> Path:
    """Write a kubeconfig; JSON is YAML."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return path


def named(section: str, name: str, **value: Any) -> dict[str, Any]:
    return {"name": name, section: value}


def whole(user: dict[str, Any], **cluster: Any) -> dict[str, Any]:
    return {
        "current-context": "one",
        "contexts": [named("context", "one", cluster="c", user="u")],
        "clusters": [named("cluster", "c", **{"server": "https://one:6443", **cluster})],
        "users": [named("user", "u", **user)],
    }


def test_the_current_context_or_the_named_one(tmp_path: Path) -> None:
    """Server and namespace come from the context's cluster and the context."""
    path = write(
        tmp_path / "config",
        **{
            "current-context": "one",
            "contexts": [
                named("context", "one", cluster="c1", user="u"),
                named("context", "two", cluster="c2", user="u", namespace="robots"),
            ],
            "clusters": [
                named("cluster", "c1", server="https://one:6443/"),
                named("cluster", "c2", server="https://two:6443"),
            ],
        },
    )
    one, two = load(path), load(path, "two")
    assert (one.server, one.context, one.namespace) == ("https://one:6443", "one", "default")
    assert (two.server, two.context, two.namespace) == ("https://two:6443", "two", "robots")


def test_several_files_are_one_and_the_first_wins(tmp_path: Path) -> None:
    """$KUBECONFIG: what stands first wins; missing files do not matter; paths are each file's."""
    first = write(
        tmp_path / "a" / "config",
        **{
            "contexts": [named("context", "one", cluster="c", user="u")],
            "users": [named("user", "u", **{"client-certificate": "cert.pem"})],
        },
    )
    (tmp_path / "a" / "cert.pem").write_text("CERT A")
    second = write(
        tmp_path / "b" / "config",
        **{
            "current-context": "one",
            "clusters": [named("cluster", "c", server="https://b:6443")],
            "users": [named("user", "u", token="loses")],
        },
    )
    missing = tmp_path / "none"
    target = load(None, None, {"KUBECONFIG": f"{first}:{missing}:{second}"})
    assert target.server == "https://b:6443"
    credentials = target.credentials()
    assert credentials.certificate == "CERT A"
    assert list(credentials.headers(fresh=False)) == []


def test_the_first_current_context_is_current(tmp_path: Path) -> None:
    """A file that names none leaves it to the next."""
    none = write(tmp_path / "none")
    one = write(tmp_path / "one", **whole({}))
    other = write(
        tmp_path / "other",
        **{
            "current-context": "other",
            "contexts": [named("context", "other", cluster="c", user="u")],
        },
    )
    assert load(None, None, {"KUBECONFIG": f"{none}:{one}:{other}"}).context == "one"
    assert load(None, None, {"KUBECONFIG": f"{none}:{other}:{one}"}).context == "other"


def test_certificates_stand_inline_or_in_files(tmp_path: Path) -> None:
    """Data wins over a file, as with kubectl."""
    data = base64.b64encode(b"INLINE").decode()
    (tmp_path / "ca.pem").write_text("FILE")
    options = {
        "certificate-authority": "ca.pem",
        "tls-server-name": "name",
        "proxy-url": "http://p",
    }
    path = write(tmp_path / "config", **whole({}, **options))
    target = load(path)
    assert (target.authority, target.server_name, target.proxy) == ("FILE", "name", "http://p")
    path = write(tmp_path / "config", **whole({}, **{"certificate-authority-data": data}))
    assert load(path).authority == "INLINE"
    path = write(tmp_path / "config", **whole({}, **{"insecure-skip-tls-verify": True}))
    assert load(path).insecure


IMPERSONATED = {
    "as": "bob",
    "as-uid": "7",
    "as-groups": ["a", "b"],
    "as-user-extra": {"scopes": ["view", "list"], "example.com/team": ["x"]},
}
IMPERSONATION = [
    ("Impersonate-User", "bob"),
    ("Impersonate-Uid", "7"),
    ("Impersonate-Group", "a"),
    ("Impersonate-Group", "b"),
    ("Impersonate-Extra-scopes", "view"),
    ("Impersonate-Extra-scopes", "list"),
    ("Impersonate-Extra-example.com%2Fteam", "x"),
]


@pytest.mark.programs
@pytest.mark.parametrize(
    ("user", "own"),
    [
        ({"token": "t"}, [("Authorization", "Bearer t")]),
        ({"tokenFile": "token"}, [("Authorization", "Bearer from-file")]),
        ({"username": "ann", "password": "x"}, [("Authorization", "Basic YW5uOng=")]),
        ({"client-certificate-data": "Q0VSVA==", "client-key-data": "S0VZ"}, []),
        ({"exec": "program"}, [("Authorization", "Bearer token-1")]),
    ],
)
def test_impersonation_is_laid_over_any_credentials(
    tmp_path: Path, user: dict[str, Any], own: Any
) -> None:
    """Who sets `as: readonly` must never write with all their rights."""
    (tmp_path / "token").write_text("from-file")
    if "exec" in user:
        user = {"exec": program(tmp_path, "2999-01-01T00:00:00Z")}
    path = write(tmp_path / "config", **whole({**user, **IMPERSONATED}))
    credentials = load(path).credentials()
    assert list(credentials.headers(fresh=False)) == [*IMPERSONATION, *own]
    if "client-certificate-data" in user:
        assert (credentials.certificate, credentials.key) == ("CERT", "KEY")


def test_an_auth_provider_is_refused_with_a_way_out(tmp_path: Path) -> None:
    """Continuing without the credentials would be worse than an error."""
    user = {"auth-provider": {"name": "oidc", "config": {"id-token": "secret"}}}
    path = write(tmp_path / "config", **whole(user))
    with pytest.raises(UserError, match="context one: its user logs in") as caught:
        load(path).credentials()
    assert "kubelogin" in (caught.value.hint or "")


@pytest.mark.parametrize("content", [None, b"\xff"])
def test_a_token_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    """It is not taken for a cluster that does not answer."""
    if content is not None:
        (tmp_path / "token").write_bytes(content)
    path = write(tmp_path / "config", **whole({"tokenFile": "token"}))
    with pytest.raises(UserError, match="cannot read the token file"):
        Cluster(load(path)).server_version()


def test_a_token_file_is_read_again_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A minute later, before the server refuses what stands in it no longer, or once it has."""
    now = 1000.0
    monkeypatch.setattr("rigel_k8s.kube.credentials.time.monotonic", lambda: now)
    (tmp_path / "token").write_text("old")
    credentials = load(write(tmp_path / "config", **whole({"tokenFile": "token"}))).credentials()
    assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer old")]
    (tmp_path / "token").write_text("new")
    now += 59
    assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer old")]
    now += 2
    assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer new")]
    (tmp_path / "token").write_text("newer")
    assert list(credentials.headers(fresh=True)) == [("Authorization", "Bearer newer")]


PLUGIN = """
import json, os, pathlib, sys
info = json.loads(os.environ["KUBERNETES_EXEC_INFO"])
count = pathlib.Path(sys.argv[1])
number = int(count.read_text() or 0) + 1 if count.exists() else 1
count.write_text(str(number))
print(json.dumps({"apiVersion": info["apiVersion"], "kind": "ExecCredential", "status": {
    "token": f"{os.environ['PREFIX']}{number}", "expirationTimestamp": sys.argv[2]}}))
"""


def program(tmp_path: Path, expiry: str, **more: Any) -> dict[str, Any]:
    script = tmp_path / "plugin.py"
    script.write_text(PLUGIN)
    return {
        "apiVersion": "client.authentication.k8s.io/v1beta1",
        "command": sys.executable,
        "args": [str(script), str(tmp_path / "count"), expiry],
        "env": [{"name": "PREFIX", "value": "token-"}],
        **more,
    }


def plugin(tmp_path: Path, expiry: str, **more: Any) -> Path:
    return write(tmp_path / "config", **whole({"exec": program(tmp_path, expiry, **more)}))


@pytest.mark.programs
def test_a_credential_program_runs_once_until_its_answer_expires(tmp_path: Path) -> None:
    """Its token is kept while it is good, asked for anew when it is not."""
    credentials = load(plugin(tmp_path, "2999-01-01T00:00:00Z")).credentials()
    for _ in range(3):
        assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer token-1")]
    assert list(credentials.headers(fresh=True)) == [("Authorization", "Bearer token-2")]
    (tmp_path / "count").unlink()
    credentials = load(plugin(tmp_path, "2001-01-01T00:00:00.123456789Z")).credentials()
    assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer token-2")]


SHOW = """
import json, os
print(json.dumps({"status": {"token": os.environ["KUBERNETES_EXEC_INFO"]}}))
"""


def told(credentials: Any) -> dict[str, Any]:
    """Return what the program SHOW was told."""
    [(_, value)] = credentials.headers(fresh=False)
    content: dict[str, Any] = json.loads(value.removeprefix("Bearer "))
    return content


@pytest.mark.programs
@pytest.mark.parametrize("wanted", [True, False])
def test_a_credential_program_is_told_of_the_cluster(tmp_path: Path, wanted: Any) -> None:
    """Where the kubeconfig asks for that: a program may log in to several."""
    command = program(tmp_path, "", args=["-c", SHOW], provideClusterInfo=wanted)
    cluster = {"tls-server-name": "name", "certificate-authority-data": "Q0E="}
    info = told(
        load(write(tmp_path / "config", **whole({"exec": command}, **cluster))).credentials()
    )
    assert info["apiVersion"] == "client.authentication.k8s.io/v1beta1"
    assert info["kind"] == "ExecCredential"
    assert info["spec"].get("cluster") == (
        {"server": "https://one:6443", **cluster} if wanted else None
    )


@pytest.mark.programs
def test_a_credential_program_beside_the_kubeconfig_is_found(tmp_path: Path) -> None:
    """A path is relative to its file, a bare name is looked for on PATH."""
    script = tmp_path / "bin" / "login"
    script.parent.mkdir()
    script.write_text(f"#!{sys.executable}\n{SHOW}")
    script.chmod(0o755)
    path = write(tmp_path / "config", **whole({"exec": {"command": "bin/login"}}))
    assert told(load(path).credentials())["kind"] == "ExecCredential"


@pytest.mark.programs
def test_a_credential_program_may_give_a_certificate(tmp_path: Path) -> None:
    """Instead of a token."""
    status = {"clientCertificateData": "CERT", "clientKeyData": "KEY"}
    path = plugin(tmp_path, "", args=["-c", f"print({json.dumps(json.dumps({'status': status}))})"])
    credentials = load(path).credentials()
    assert (credentials.certificate, credentials.key) == ("CERT", "KEY")
    assert list(credentials.headers(fresh=False)) == []


@pytest.mark.programs
def test_a_token_that_is_about_to_expire_is_renewed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A request takes time, and clocks differ."""
    end = datetime(2030, 1, 1, tzinfo=timezone.utc).timestamp()
    credentials = load(plugin(tmp_path, "2030-01-01T00:00:00Z")).credentials()
    for before, token in ((60, "token-1"), (10, "token-2")):
        monkeypatch.setattr("rigel_k8s.kube.credentials.time.time", lambda b=before: end - b)
        assert list(credentials.headers(fresh=False)) == [("Authorization", f"Bearer {token}")]


@pytest.mark.programs
def test_a_credential_program_that_fails_is_named(tmp_path: Path) -> None:
    """With its own words and the hint that the kubeconfig has for it."""
    hint = {"installHint": "install the plugin"}
    path = plugin(tmp_path, "x", command="no-such-program-anywhere", **hint)
    with pytest.raises(ClusterError, match="no-such-program-anywhere gave no cred") as caught:
        load(path).credentials()
    assert caught.value.hint == "install the plugin"
    path = plugin(tmp_path, "x", args=["-c", "import sys; sys.exit('log in first')"])
    with pytest.raises(ClusterError) as caught:
        load(path).credentials()
    assert caught.value.details == ("log in first",)


TELL = 'import json; print(json.dumps({"status": %s}))'


@pytest.mark.programs
@pytest.mark.parametrize(
    ("status", "wrong"),
    [
        ("['TOKEN']", "its status is a list"),
        ("None", "its status is null"),
        ("'TOKEN'", "its status is text"),
        ("{}", "neither a token nor a certificate"),
        ("{'token': ['TOKEN']}", "its status.token is a list"),
        ("{'token': 7}", "its status.token is a number"),
        ("{'token': {'TOKEN': 1}}", "its status.token is an object"),
        ("{'token': 'TOKEN\\nX: y'}", "letters that a header cannot carry"),
        ("{'token': 'TOKEN\\u2028'}", "letters that a header cannot carry"),
        ("{'token': 'TOKEN', 'expirationTimestamp': 'soon'}", "not an RFC 3339 time"),
        ("{'token': 'TOKEN', 'expirationTimestamp': 17}", "expirationTimestamp is a number"),
        ("{'clientCertificateData': 'TOKEN'}", "a certificate or a key without the other"),
        ("{'clientCertificateData': 1, 'clientKeyData': 'TOKEN'}", "is a number"),
    ],
)
def test_an_odd_credential_program_is_told_what_it_must_print(
    tmp_path: Path, status: str, wrong: str
) -> None:
    """One error that names it, whatever it prints, and never the token."""
    path = plugin(tmp_path, "", args=["-c", TELL % status])
    with pytest.raises(ClusterError, match="gave no credentials") as caught:
        load(path).credentials()
    error = caught.value
    assert sys.executable in error.message
    text = "\n".join(error.details)
    assert wrong in text
    assert "it must print an ExecCredential" in text
    assert "TOKEN" not in "".join(format_exception(error)) + text


@pytest.mark.programs
@pytest.mark.parametrize("stamp", ["2999-01-01T00:00:00", "2999-01-01T00:00:00+02:00", ""])
def test_an_expiry_may_have_no_zone(tmp_path: Path, stamp: str) -> None:
    """Then it is one of UTC; and there may be none."""
    status = f"{{'token': 'good', 'expirationTimestamp': '{stamp}'}}"
    credentials = load(plugin(tmp_path, "", args=["-c", TELL % status])).credentials()
    assert list(credentials.headers(fresh=False)) == [("Authorization", "Bearer good")]


@pytest.mark.parametrize(
    "odd",
    [
        {"command": ["x"]},
        {"command": 7},
        {"args": "x"},
        {"env": {"a": "b"}},
        {"env": ["a"]},
        ["x"],
        "x",
    ],
)
def test_a_credential_program_that_is_described_wrongly_is_the_users(
    tmp_path: Path, odd: Any
) -> None:
    """The kubeconfig is what the user wrote."""
    program = {"command": "login", **odd} if isinstance(odd, dict) else odd
    path = write(tmp_path / "config", **whole({"exec": program}))
    with pytest.raises(UserError, match="does not define the credential program"):
        load(path).credentials()


@pytest.mark.parametrize(
    "data", ["%%%%", "Z2FyYmFnZQ==", "Z2FyYmFnZ", "/////w==", "LS0tLS1CRUdJTiBDRVJU"]
)
def test_an_authority_that_is_none_is_the_users(tmp_path: Path, data: str) -> None:
    """Not base64, or no certificate: exit code 2, and no other authority is trusted instead."""
    path = write(tmp_path / "config", **whole({}, **{"certificate-authority-data": data}))
    with pytest.raises(UserError, match="certificate") as caught:
        Cluster(load(path)).server_version()
    assert caught.value.exit_code == 2


@pytest.mark.programs
@pytest.mark.parametrize(
    "code",
    [
        "print('TOKEN'); sys.exit('log in first')",
        "print('{TOKEN')",
        'print(\'{"status": null, "x": "TOKEN"}\')',
        "print('TOKEN', flush=True); open('SLOW', 'w').close(); time.sleep(60)",
        "print('[\"TOKEN\"]')",
    ],
)
def test_what_a_credential_program_prints_is_never_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    """Its output is the token: not in the message, the hint, the details, nor with --verbose."""
    script, printed = tmp_path / "login.py", tmp_path / "printed"
    script.write_text(f"import sys, time; {code.replace('SLOW', str(printed))}")
    for seconds in (0.3, 3, 60) if "SLOW" in code else (60,):
        monkeypatch.setattr("rigel_k8s.kube.credentials.PLUGIN_TIMEOUT", seconds)
        with pytest.raises(ClusterError, match="gave no credentials") as caught:
            load(plugin(tmp_path, "x", args=[str(script)])).credentials()
        if printed.exists():  # on a slow machine it may not have begun to print
            break
    assert printed.exists() == ("SLOW" in code)
    error = caught.value
    assert "TOKEN" not in f"{error.message} {error.hint} {error.details}"
    assert "TOKEN" not in "".join(format_exception(error))


def test_no_kubeconfig_names_the_ways_to_a_cluster(tmp_path: Path) -> None:
    """Where it was looked for, and how to get one."""
    with pytest.raises(UserError, match="no cluster is configured") as caught:
        load(None, None, {"HOME": str(tmp_path)})
    assert str(tmp_path / ".kube" / "config") in caught.value.message
    for word in ("rigel cluster up", "kind", "minikube"):
        assert word in (caught.value.hint or "")
    with pytest.raises(UserError, match="there is no kubeconfig"):
        load(tmp_path / "none")


def test_an_unknown_context_lists_the_known_ones(tmp_path: Path) -> None:
    """A slip of the pen is easily mended."""
    path = write(tmp_path / "config", **whole({}))
    with pytest.raises(UserError, match="there is no context on in") as caught:
        load(path, "on")
    assert caught.value.hint == "there are: one"


def test_a_kubeconfig_that_is_none_is_told(tmp_path: Path) -> None:
    """Not YAML, no mapping, a context without its cluster."""
    path = tmp_path / "config"
    path.write_text("a: [")
    with pytest.raises(UserError, match="is not YAML"):
        load(path)
    path.write_text("- a")
    with pytest.raises(UserError, match="is not a mapping"):
        load(path)
    write(path, **{**whole({}), "clusters": []})
    with pytest.raises(UserError, match="which has no server"):
        load(path)


def test_a_pod_uses_its_service_account(tmp_path: Path) -> None:
    """In a cluster, with no kubeconfig: its address, its CA, its token, its namespace."""
    for name, text in (("token", "t\n"), ("ca.crt", "CA"), ("namespace", "robots\n")):
        (tmp_path / name).write_text(text)
    environ = {
        "HOME": str(tmp_path),
        "KUBERNETES_SERVICE_HOST": "fd00::1",
        "KUBERNETES_SERVICE_PORT": "443",
    }
    target = load(None, None, environ, tmp_path)
    assert (target.server, target.namespace, target.authority, target.context) == (
        "https://[fd00::1]:443",
        "robots",
        "CA",
        "",
    )
    assert list(target.credentials().headers(fresh=False)) == [("Authorization", "Bearer t")]


def list_odd(value: Any) -> Iterator[Any]:
    """Yield copies of a value, each with one part replaced by something of another type."""
    yield from (3, "text", [], ["text"], [3], {}, {"text": 3}, None, True)
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from ({**value, key: odd} for odd in list_odd(inner))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from ([*value[:number], odd, *value[number + 1 :]] for odd in list_odd(inner))


def test_an_odd_kubeconfig_is_never_a_bug(tmp_path: Path) -> None:
    """Whatever stands where something else belongs, it is used or refused in one error."""
    user = {"token": "t", "as": "me", "as-groups": ["a"], "as-user-extra": {"b": ["c"]}}
    refused = 0
    for odd in list_odd(whole(user, **{"certificate-authority": "ca", "proxy-url": "http://p"})):
        path = tmp_path / "config"
        path.write_text(json.dumps(odd))
        (tmp_path / "ca").write_text("CA")
        try:
            list(load(path).credentials().headers(fresh=False))
        except UserError:
            refused += 1
    assert refused > 50


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    """Nothing may ever be written to it."""
    os.mkfifo(tmp_path / "config")
    with pytest.raises(UserError, match="is a pipe"):
        load(tmp_path / "config")
