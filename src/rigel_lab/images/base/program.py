"""An image of one Python program: Debian's Python and the program, nothing else and no shell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import attrs

from rigel_k8s import __version__
from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import Entry, architecture, layer
from rigel_lab.images.base.bootstrap import EXTRACT
from rigel_lab.images.base.build import EPOCH, Recipe, prepare_nothing

SUITE = "bookworm"
#: Where Python finds the program.
PREFIX = "opt/rigel-k8s"
#: The few files of /etc that Debian's setup would make, for programs that ask who they are. No one
#: logs in.
ETC = (
    Entry("etc/group", b"root:x:0:\nnonroot:x:65532:\n"),
    Entry("etc/nsswitch.conf", b"hosts: files dns\n"),
    Entry(
        "etc/passwd",
        b"root:x:0:0:root:/:/sbin/nologin\nnonroot:x:65532:65532:nonroot:/tmp:/sbin/nologin\n",
    ),
)


@attrs.frozen(kw_only=True)
class ProgramImage:
    """The image of a program.

    Attributes:
        name: the image's last name, and its directory in the cache.
        title: what the image is, for people.
        module: what Python runs.
        arguments: the program's, if a container sets none.
        environment: variables beside those that each such image has.
        packages: Debian's packages beside Python.
    """

    name: str
    title: str
    module: str
    arguments: Sequence[str]
    environment: Sequence[str] = ()
    packages: Sequence[str] = ()

    @property
    def reference(self) -> str:
        """The name that podman and docker give it when they load it."""
        return f"localhost/rigel-k8s/{self.name}:{__version__}"

    @property
    def upstream(self) -> str:
        """The name that pods ask for."""
        return f"ghcr.io/rigel-k8s/{self.name}:{__version__}"

    @property
    def config(self) -> Mapping[str, str | Sequence[str]]:
        """The `config` of an OCI image configuration."""
        return {
            "Entrypoint": ["/usr/bin/python3", "-m", self.module],
            "Cmd": list(self.arguments),
            "Env": [
                "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
                "LANG=C.UTF-8",
                f"PYTHONPATH=/{PREFIX}",
                "PYTHONDONTWRITEBYTECODE=1",
                "PYTHONUNBUFFERED=1",
                *self.environment,
            ],
            "User": "65532:65532",
        }

    def make_recipe(
        self,
        entries: Iterable[Entry],
        *,
        arch: str | None = None,
        locked: bytes = b"",
        prepare: Callable[[Path, Reporter], Sequence[str]] = prepare_nothing,
    ) -> Recipe:
        """Return the image's recipe.

        Args:
            entries: the program's files, and those of ETC.
            arch: as a Recipe has it; None: that of this machine.
            locked, prepare: as a Recipe has them.
        """
        return Recipe(
            title=self.title,
            family=self.name,
            name="python",
            reference=self.reference,
            suite=SUITE,
            packages=(*self.packages, "python3"),
            config=self.config,
            overlay=layer(entries, mtime=EPOCH),
            locked=locked,
            prepare=prepare,
            variant=EXTRACT,
            arch=arch or architecture(),
        )
