"""What commands import: what they do not use costs them nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

RIGELFILE = """\
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: robot
      deploy_ros_master: false
      ros_master_uri: http://robot:11311
      nodes:
        talker: {image: "registry.lab/talker@sha256:DIGEST", command: [talk], readiness: none}
"""
KUBECONFIG = """\
apiVersion: v1
kind: Config
current-context: away
contexts: [{name: away, context: {cluster: away, user: away}}]
clusters: [{name: away, cluster: {server: "http://127.0.0.1:1"}}]
users: [{name: away, user: {}}]
"""
#: Features that this Rigelfile does not use, and standard modules that take longest to import.
UNUSED = (
    "asyncio",
    "html",
    "http.server",
    "jinja2",
    "multiprocessing",
    "regex",
    "rich",
    "rigel_exporter",
    "rigel_graph.discovery",
    "rigel_graph.watching",
    "rigel_build.docker",
    "rigel_k8s.jobs.rigelstyle",
    "rigel_muto",
    "rigel_k8s.network.modes.attached",
    "rigel_k8s.network.modes.discovery_server",
    "rigel_k8s.network.modes.peers",
    "rigel_k8s.network.modes.zenoh",
    "rigel_multus.install",
    "rigel_multus.preflight",
    "rigel_stack.boards",
    "rigel_stack.install",
    "rigel_k8s.observability.reading",
    "rigel_lab",
    "tarfile",
    "unittest",
    "xml",
)


def test_a_plain_deploy_imports_no_feature_that_it_does_not_use(tmp_path: Path) -> None:
    """Most of the time of a small deploy is imports: each of these would make all deploys slower.

    `check` goes the deploy's way up to the cluster; the rest is imported here.
    """
    file = tmp_path / "Rigelfile"
    file.write_text(RIGELFILE.replace("DIGEST", "0" * 64))
    code = (
        "import sys\n"
        "from rigel_k8s.cli.main import run\n"
        "import rigel_k8s.cli.runs, rigel_k8s.deploy, rigel_k8s.kube.cluster\n"
        f"assert run(['-q', '-f', {str(file)!r}, 'check'], 'rigel') == 0\n"
        f"print([m for m in {UNUSED!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


#: What only deploying needs.
DEPLOYING = (
    "rigel_k8s.app.checks",
    "rigel_k8s.app.deploying.prepare",
    "rigel_k8s.app.desired",
    "rigel_k8s.images",
    "rigel_k8s.jobs.runner",
    "rigel_stack.manifests",
    "rigel_k8s.deploy",
    "rigel_k8s.release.plan",
    "rigel_k8s.release.removal",
    "rigel_k8s.release.rollback",
)


def test_status_imports_nothing_that_only_deploying_needs(tmp_path: Path) -> None:
    """It is called often. Here it ends at a cluster that is away: guests are asked after that."""
    file = tmp_path / "Rigelfile"
    file.write_text(RIGELFILE.replace("DIGEST", "0" * 64))
    config = tmp_path / "config"
    config.write_text(KUBECONFIG)
    others = [*DEPLOYING, *UNUSED]
    words = ["--kubeconfig", str(config), "-f", str(file), "status"]
    code = (
        "import sys\n"
        "from rigel_k8s.cli.main import run\n"
        f"assert run({words!r}, 'rigel') == 1\n"
        f"print([m for m in {others!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "does not answer" in done.stderr
    assert done.stdout.strip() == "[]"


def test_no_command_but_muto_loads_muto() -> None:
    """Whoever has no stack of Eclipse Muto pays nothing for it, and `rigel_k8s` is without it."""
    code = (
        "import sys, importlib, pkgutil, rigel_k8s\n"
        "from rigel_k8s.cli import main\n"
        "for module, _ in main.COMMANDS.values():\n"
        "    importlib.import_module(f'rigel_k8s.cli.{module}')\n"
        "for one in pkgutil.walk_packages(rigel_k8s.__path__, 'rigel_k8s.'):\n"
        "    if '.cli.' in one.name or '.commands.' in one.name or '.jobs.' in one.name:\n"
        "        importlib.import_module(one.name)\n"
        "assert main.run(['version'], 'rigel') == 0\n"
        "print([m for m in sys.modules if m.startswith('rigel_muto')], file=sys.stderr)\n"
        "assert main.run(['muto', 'convert', '--help'], 'rigel') == 0\n"
        "assert 'rigel_muto.cli' in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
