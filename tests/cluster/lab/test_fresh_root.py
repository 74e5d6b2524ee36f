"""`./run lint` and `./run unit` in an empty Debian: they install all that they need themselves."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,
    pytest.mark.timeout(3000),
    pytest.mark.skipif(os.geteuid() != 0, reason="a root file system needs root"),
]

PROJECT = Path(__file__).parents[3]
#: How this machine reaches packages: its certificates, and its settings of apt and pip.
REACH = (
    *("etc/ssl", "usr/local/share/ca-certificates", "etc/resolv.conf", "etc/pip.conf"),
    *(f"etc/apt/apt.conf.d/{path.name}" for path in Path("/etc/apt/apt.conf.d").glob("99*")),
)
#: Makes the directory the root, with the kernel's file systems, in a mount namespace that ends with
#: it: pivot_root, since nobody may make user namespaces in a chroot; the first process is a shell,
#: since a first process must wait for children that others left.
ENTER = """
mount --bind "$0" "$0"
cd "$0"
mount -t proc proc proc
for name in sys dev; do mount --rbind "/$name" "$name"; done
pivot_root . .
umount --lazy .
cd /project
/bin/bash -c "$1" || exit 1
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Debian's smallest system with Python and certificates, and a clone of the project."""
    made = tmp_path_factory.mktemp("fresh") / "root"
    words = ["mmdebstrap", "--variant=minbase", "--include=python3,ca-certificates", "bookworm"]
    subprocess.run([*words, str(made)], check=True, capture_output=True)
    for path in REACH:
        source, target = Path("/", path), made / path
        if source.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            copy = ["cp", "--archive", "--no-target-directory", "--remove-destination"]
            subprocess.run([*copy, str(source), str(target)], check=True)
    subprocess.run(["git", "clone", "-q", str(PROJECT), str(made / "project")], check=True)
    yield made
    shutil.rmtree(made)


@pytest.mark.parametrize("command", ["./run lint", "./run unit -q"])
def test_it_installs_what_it_needs(root: Path, command: str) -> None:
    """And works again when it is run again, which is much quicker."""
    own = ("PIP_CERT", "PIP_DEFAULT_TIMEOUT", "http_proxy", "https_proxy", "no_proxy")
    environ = {key: value for key, value in os.environ.items() if key in own}
    environ |= {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "CI": "true"}
    words = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-euc", ENTER]
    done = subprocess.run(
        [*words, str(root), command], env=environ, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-9000:]
