"""Which rights people need: to deploy applications in a namespace, to view them, or to install.

They are in rights.yaml. `rigel rbac` prints them as roles, and `rigel doctor` asks a cluster for
them. A deploy's own check (`release/refusals/missing.py`) tests the part that this deploy needs.
"""

from __future__ import annotations

from importlib.resources import files

import yaml

from rigel_k8s.objects.rights import Right, grant

#: The sections of the file that a user with a purpose needs.
PURPOSES = {
    "deployer": ("deploy", "gate", "more", "view"),
    "viewer": ("view",),
    "installer": ("install",),
}


def read_rights(sections: tuple[str, ...], namespace: str) -> set[Right]:
    """Return the rights in some sections of the file, in a namespace ("": the whole cluster)."""
    content = yaml.safe_load(files(__package__).joinpath("rights.yaml").read_text("utf-8"))
    rights: set[Right] = set()
    for section in sections:
        for kind, verbs in content[section].items():
            name, slash, sub = kind.partition("/")
            plural, _, group = name.partition(".")
            rights.update(grant(group, plural + slash + sub, verbs, namespace))
    return rights
