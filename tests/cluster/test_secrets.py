"""Planted secrets are nowhere but where they belong: in no output, process, file or revision."""

from __future__ import annotations

import base64
import gzip
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import attrs
import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef
from tests.support.planted import ENOUGH, find, find_left, tracing

from .rights import grant_role, write_impersonation, write_kubeconfig

pytestmark = pytest.mark.cluster

#: Variables of the environment, which all children have: a registry's password, Grafana's, and
#: that of an image's build.
PASSWORD, GRAFANA, BUILD = "planted-registry-pw", "planted-grafana-pw", "planted-build-token"
#: Of the kubeconfig: the password in a server's URL.
SERVER = "planted-server-pw"
#: Of Secrets that the user has made: a variable's, a file's, a Loki's.
WIFI, CERTIFICATE, LOKI = "planted-wifi-key", "planted-robot-certificate", "planted-loki-pw"
RELEASE = "rigel-k8s-application"
EXEC = "client.authentication.k8s.io/v1"
#: Run one after the other, then all at once; each with its exit code.
WRITES = (("run job deploy", 0), ("run job deploy", 0))
LOOKS = (
    ("check", 0),
    ("render", 0),
    ("render deploy", 0),
    ("diff", 0),
    ("status", 0),
    ("status --no-graph -o json", 0),
    ("graph", 1),
    ("logs talker --tail 5", 0),
    ("exec talker true", 0),
    ("top", 1),
    ("history -o json", 0),
    ("list -o json", 0),
    ("doctor", 0),
    ("observe status", 2),
    ("network status", 1),
    ("rbac deployer", 0),
    ("schema", 0),
)


@attrs.frozen
class Planted:
    """What was planted where.

    Attributes:
        token: of the credential program.
        key: a part of the key of a client certificate, as it is in the kubeconfig.
        pem: a part of the same key as OpenSSL reads it.
    """

    directory: Path
    namespace: str
    token: str
    key: str
    pem: str

    @property
    def hidden(self) -> set[str]:
        """The secrets that not even a child's environment has."""
        return {SERVER, WIFI, CERTIFICATE, LOKI, self.token, self.key, self.pem}

    @property
    def all(self) -> set[str]:
        """All secrets."""
        return {PASSWORD, GRAFANA, BUILD, *self.hidden}

    @property
    def temporary(self) -> Path:
        """HOME and every place in which a program keeps files."""
        return self.directory / "temporary"

    def environ(self) -> dict[str, str]:
        """Return the environment of a command."""
        places = {
            name: str(self.temporary / name.lower())
            for name in ("HOME", "XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME")
        }
        made = {
            **os.environ,
            **places,
            "password": PASSWORD,
            "grafana": GRAFANA,
            "build_token": BUILD,
            "TMPDIR": str(self.temporary),
            "KUBECONFIG": str(self.directory / "kubeconfig"),
        }
        return made

    def run(self, words: str, code: int, *, context: str = "x", verbose: bool = True) -> str:
        """Run a command and return all that it prints."""
        place = ("-f", str(self.directory / "Rigelfile"), "--context", context)
        options = (*(["-v"] if verbose else []), *place, "-n", self.namespace)
        command = [sys.executable, "-m", "rigel_k8s", *options, *words.split()]
        done = subprocess.run(
            command, env=self.environ(), capture_output=True, text=True, check=False
        )
        assert done.returncode == code, (words, done.stdout, done.stderr)
        return done.stdout + done.stderr


@pytest.fixture
def planted(cluster: Any, namespace: str, context: str, registry: str, tmp_path: Path) -> Planted:
    """Secrets in a kubeconfig, in the environment and on the cluster."""
    config, token = write_credential_program(cluster, namespace, context, tmp_path)
    (tmp_path / "admin").mkdir()
    own = yaml.safe_load(write_impersonation(context, "nobody", tmp_path / "admin").read_text())
    key = add_certificate(config, own, context)
    (tmp_path / "kubeconfig").write_text(json.dumps(config))
    for name, value in (("wifi", WIFI), ("certificate", CERTIFICATE), ("loki", LOKI)):
        meta = {"name": name, "namespace": namespace}
        data = {"username": "me", "password": value}
        cluster.create({"apiVersion": "v1", "kind": "Secret", "metadata": meta, "stringData": data})
    write_rigelfile(tmp_path, registry)
    (tmp_path / "temporary").mkdir()
    middle = len(key) // 2
    lines = base64.b64decode(key).decode().splitlines()
    return Planted(
        tmp_path, namespace, token, key[middle : middle + ENOUGH], lines[len(lines) // 2][:ENOUGH]
    )


def write_credential_program(
    cluster: Any, namespace: str, context: str, directory: Path
) -> tuple[dict[str, Any], str]:
    """Return a kubeconfig whose user gets a deployer's token by a program, and the token."""
    meta = {"name": "robot", "namespace": namespace}
    cluster.create({"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta})
    grant_role(cluster, namespace, "deployer", f"system:serviceaccount:{namespace}:robot")
    config = yaml.safe_load(
        write_kubeconfig(cluster, namespace, "robot", context, directory).read_text()
    )
    token = str(config["users"][0]["user"]["token"])
    answer = {"apiVersion": EXEC, "kind": "ExecCredential", "status": {"token": token}}
    file = directory / "credential.json"
    file.write_text(json.dumps(answer))
    program = {"apiVersion": EXEC, "command": "cat", "args": [str(file)]}
    config["users"][0]["user"] = {"exec": {**program, "interactiveMode": "Never"}}
    there = config["clusters"][0]["cluster"]
    there["server"] = there["server"].replace("://", f"://me:{SERVER}@")
    away = {**there, "server": f"https://me:{SERVER}@127.0.0.1:1"}
    config["clusters"].append({"name": "away", "cluster": away})
    config["contexts"].append({"name": "away", "context": {"cluster": "away", "user": "u"}})
    return config, token


def add_certificate(config: dict[str, Any], own: dict[str, Any], context: str) -> str:
    """Add a context with the administrator's certificate; return its key as it is written."""
    [found] = [one["context"] for one in own["contexts"] if one["name"] == context]
    [user] = [one["user"] for one in own["users"] if one["name"] == found["user"]]
    user = {key: value for key, value in user.items() if key != "as"}
    config["users"].append({"name": "admin", "user": user})
    config["contexts"].append({"name": "admin", "context": {"cluster": "c", "user": "admin"}})
    return str(user["client-key-data"])


def write_rigelfile(directory: Path, registry: str) -> None:
    """Write a job that deploys, and one that builds an image."""
    variable = {"name": "WIFI", "valueFrom": {"secretKeyRef": {"name": "wifi", "key": "password"}}}
    node = {
        "ros": "none",
        "command": ["sh", "-c", "while true; do sleep 0.1; done"],
        "readiness": "none",
        "env": [variable],
        "volumes": [{"secret": "certificate", "mount_path": "/certificate"}],
    }
    loki = {"url": "http://loki.logging:3100", "secret": "loki"}
    deploy = {
        "image": f"{registry}/rigel-k8s/busybox:1",
        "nodes": {"talker": node},
        "observability": {
            "enabled": False,
            "grafana": {"admin_password": "{{ vars.grafana }}"},
            "existing": {"loki": loki},
        },
    }
    build = {
        "image": f"{registry}/planted:1",
        "push": True,
        "insecure": True,
        "tool": "podman",
        "platforms": [],
        "buildargs": {"TOKEN": "{{ vars.build_token }}"},
    }
    user = {"server": registry, "username": "me", "password": "{{ vars.password }}"}
    content = {
        "application": {"distro": "jazzy"},
        "providers": {
            "registry": {"provider": "rigel_k8s.ContainerRegistryProvider", "with": user}
        },
        "jobs": {
            "deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": deploy},
            "build": {"plugin": "rigel_k8s.BuildXPlugin", "with": build},
            "broken": {
                "plugin": "rigel_k8s.BuildXPlugin",
                "with": {**build, "dockerfile": "broken"},
            },
        },
    }
    (directory / "Rigelfile").write_text(json.dumps(content))
    (directory / "Dockerfile").write_text("FROM scratch\nARG TOKEN\nCOPY Dockerfile /\n")
    (directory / "broken").write_text("FROM scratch\nARG TOKEN\nCOPY nothing-like-this /\n")


def test_planted_secrets_are_nowhere_but_where_they_belong(cluster: Any, planted: Planted) -> None:
    """All commands, with and without -v, some of which fail; then every place is searched."""
    with tracing(planted.temporary, planted.all) as trace:
        told = run_all(planted)
    secrets = planted.all
    assert {words: find(secrets, text) for words, text in told.items() if find(secrets, text)} == {}
    assert [line for line in trace.arguments if find(secrets, line)] == []
    of_pods = "KUBERNETES_SERVICE_HOST="  # on a local cluster their processes are seen too
    ours = [line for line in trace.environments if of_pods not in line]
    assert [line for line in ours if find(planted.hidden, line)] == []
    assert trace.exposed == set()
    assert find_left(planted.temporary, secrets) == []
    assert any("rigel_k8s" in line for line in trace.arguments), "no process was seen"
    assert any(BUILD in line for line in trace.environments), "no environment was seen"
    belong = {"wifi", "certificate", "loki"}
    for live in list_objects(cluster, planted.namespace):
        text = json.dumps(live) + read_revision(live) + decode(live)
        if live["metadata"]["name"] == f"{RELEASE}-registry":
            assert find(secrets, text)
            assert find(secrets - {PASSWORD}, text) == []
        elif live["metadata"]["name"] not in belong:
            assert find(secrets, text) == [], live["metadata"]["name"]
    undo(planted)
    left = ObjectRef("v1", "Secret", planted.namespace, f"{RELEASE}-registry")
    assert cluster.get(left) is None


def run_all(planted: Planted) -> dict[str, str]:
    """Return what commands printed, by their words."""
    told = {f"{number} {words}": planted.run(words, 0) for number, (words, _) in enumerate(WRITES)}

    def look(command: tuple[str, int]) -> tuple[str, str]:
        return command[0], planted.run(*command)

    with ThreadPoolExecutor(4) as pool:
        told |= dict(pool.map(look, LOOKS))
    told["plain render"] = planted.run("render deploy", 0, verbose=False)
    told["as admin"] = planted.run("list", 0, context="admin")
    for words, context in (("doctor", "away"), ("run job deploy", "away")):
        told[f"{words} away"] = planted.run(words, 1, context=context)
    if shutil.which("podman"):
        told["build"] = planted.run("run job build", 0)
        told["broken build"] = planted.run("run job broken", 1)
    told["rollback"] = planted.run("rollback 1", 0)
    return told


def undo(planted: Planted) -> None:
    """Take the release away, which prints no secret either."""
    assert find(planted.all, planted.run("down", 0)) == []


def list_objects(cluster: Any, namespace: str) -> Iterator[Any]:
    """Yield the objects of a namespace that may hold what they must not."""
    for kind in (("v1", "Secret"), ("v1", "ConfigMap"), ("v1", "Pod"), ("apps/v1", "Deployment")):
        yield from cluster.list(*kind, namespace)


def read_revision(live: Any) -> str:
    """Return what a revision's Secret holds."""
    data = (live.get("data") or {}).get("release") if live["kind"] == "Secret" else None
    return gzip.decompress(base64.b64decode(data)).decode() if data else ""


def decode(live: Any) -> str:
    """Return a Secret's values as they were before they were encoded."""
    values = (live.get("data") or {}).values() if live["kind"] == "Secret" else ()
    return " ".join(base64.b64decode(value).decode("utf-8", "replace") for value in values)
