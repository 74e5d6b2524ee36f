"""Planted secrets are nowhere but where they belong: in no output, process, file or revision."""

from __future__ import annotations

import base64
import gzip
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from .rights import grant_role, write_kubeconfig

pytestmark = pytest.mark.cluster

PASSWORD, GRAFANA, SERVER = "planted-registry-pw", "planted-grafana-pw", "planted-server-pw"
RELEASE = "rigel-k8s-application"


def forms(secret: str) -> set[str]:
    """Return a secret as it is, and as base64 by itself and behind the user's name."""
    texts = (secret, f"me:{secret}")
    return {secret, *(base64.b64encode(text.encode()).decode().rstrip("=") for text in texts)}


def find(secrets: set[str], text: str) -> list[str]:
    return [form for secret in secrets for form in forms(secret) if form in text]


@contextmanager
def sampling_processes() -> Iterator[set[str]]:
    """Collect the arguments of all processes for as long as the context is open."""
    seen: set[str] = set()
    over = threading.Event()

    def sample() -> None:
        while not over.wait(0.02):
            for file in Path("/proc").glob("[0-9]*/cmdline"):
                try:
                    seen.add(file.read_bytes().replace(b"\0", b" ").decode("utf-8", "replace"))
                except OSError:  # it has ended
                    continue

    thread = threading.Thread(target=sample)
    thread.start()
    try:
        yield seen
    finally:
        over.set()
        thread.join()


@pytest.fixture
def token(cluster: Any, namespace: str, context: str, tmp_path: Path) -> str:
    """Write a kubeconfig whose credential program prints a token, and return the token."""
    meta = {"name": "robot", "namespace": namespace}
    cluster.create({"apiVersion": "v1", "kind": "ServiceAccount", "metadata": meta})
    user = f"system:serviceaccount:{namespace}:robot"
    grant_role(cluster, namespace, "deployer", user)
    file = write_kubeconfig(cluster, namespace, "robot", context, tmp_path)
    config = yaml.safe_load(file.read_text())
    found = str(config["users"][0]["user"]["token"])
    credential = {
        "apiVersion": "client.authentication.k8s.io/v1",
        "kind": "ExecCredential",
        "status": {"token": found},
    }
    (tmp_path / "credential.json").write_text(json.dumps(credential))
    config["users"][0]["user"] = {
        "exec": {
            "apiVersion": "client.authentication.k8s.io/v1",
            "command": "cat",
            "args": [str(tmp_path / "credential.json")],
            "interactiveMode": "Never",
        }
    }
    server = config["clusters"][0]["cluster"]["server"]
    config["clusters"][0]["cluster"]["server"] = server.replace("://", f"://me:{SERVER}@")
    lost = json.loads(json.dumps(config["clusters"][0]))
    lost["cluster"]["server"], lost["name"] = f"https://me:{SERVER}@127.0.0.1:1", "lost"
    config["clusters"].append(lost)
    config["contexts"].append({"name": "lost", "context": {"cluster": "lost", "user": "u"}})
    file.write_text(json.dumps(config))
    return found


def write_rigelfile(path: Path, registry: str) -> None:
    node = {
        "ros": "none",
        "command": ["sh", "-c", "while true; do sleep 0.1; done"],
        "readiness": "none",
    }
    job = {
        "image": f"{registry}/rigel-k8s/busybox:1",
        "nodes": {"talker": node},
        "observability": {"grafana": {"admin_password": "{{ vars.grafana }}"}, "enabled": False},
    }
    user = {"server": registry, "username": "me", "password": "{{ vars.password }}"}
    content = {
        "application": {"distro": "jazzy"},
        "providers": {
            "registry": {"provider": "rigel_k8s.ContainerRegistryProvider", "with": user}
        },
        "jobs": {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}},
    }
    path.write_text(json.dumps(content))


def test_planted_secrets_are_nowhere_but_where_they_belong(
    cluster: Any, namespace: str, registry: str, tmp_path: Path, token: str
) -> None:
    """A deploy, a change that fails, and all that only looks; then every place is searched."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    write_rigelfile(tmp_path / "Rigelfile", registry)
    env = {
        **os.environ,
        "password": PASSWORD,
        "grafana": GRAFANA,
        "TMPDIR": str(temporary),
        "XDG_CACHE_HOME": str(temporary / "cache"),
        "KUBECONFIG": str(tmp_path / "kubeconfig"),
    }
    told: dict[str, str] = {}

    def call(*words: str, code: int = 0, context: str = "x") -> str:
        place = ("-v", "-f", str(tmp_path / "Rigelfile"), "--context", context, "-n", namespace)
        command = [sys.executable, "-m", "rigel_k8s", *place, *words]
        done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        told[" ".join(words)] = done.stdout + done.stderr
        assert done.returncode == code, told
        return done.stdout

    with sampling_processes() as processes:
        call("run", "job", "deploy")
        for words in ("render", "diff", "status --no-graph", "history -o json", "doctor"):
            call(*words.split())
        call("doctor", code=1, context="lost")
        call("run", "job", "deploy", code=1, context="lost")
    secrets = {PASSWORD, GRAFANA, SERVER, token}
    assert {words: find(secrets, text) for words, text in told.items() if find(secrets, text)} == {}
    assert [line for line in processes if find(secrets, line)] == []
    left = [file for file in temporary.rglob("*") if file.is_file()]
    assert [f for f in left if find(secrets, f.read_bytes().decode("utf-8", "replace"))] == []
    assert processes, "the sampling has seen no process"
    for kind in (("v1", "Secret"), ("v1", "ConfigMap"), ("v1", "Pod"), ("apps/v1", "Deployment")):
        for live in cluster.list(*kind, namespace):
            text = json.dumps(live) + read_revision(live)
            belongs = live["metadata"]["name"] == f"{RELEASE}-registry"
            assert bool(find(secrets, text + decode(live))) is belongs, live["metadata"]["name"]


def read_revision(live: Any) -> str:
    """Return what a revision's Secret holds."""
    data = (live.get("data") or {}).get("release") if live["kind"] == "Secret" else None
    return gzip.decompress(base64.b64decode(data)).decode() if data else ""


def decode(live: Any) -> str:
    """Return a Secret's values as they were before they were encoded."""
    values = (live.get("data") or {}).values() if live["kind"] == "Secret" else ()
    return " ".join(base64.b64decode(value).decode("utf-8", "replace") for value in values)
