"""The names that resolve to job types and providers of this package; it imports none of them.

Each has a short name, its name for users of Rigel (`rigel_k8s.OrchestrationPlugin`), and the names
of Rigel's own and of src.plugin that existing Rigelfiles use.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

import attrs

Kind: TypeAlias = Literal["job", "provider"]

ENTRY_POINT_GROUPS: Mapping[Kind, str] = {
    "job": "rigel_k8s.jobs",
    "provider": "rigel_k8s.providers",
}


@attrs.frozen
class Builtin:
    """A job type or provider of this package.

    Attributes:
        short: its short name.
        target: module and class, `package.module:Class`; imported when it is needed.
        paths: the import paths that mean it.
    """

    short: str
    target: str
    paths: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that a Rigelfile may use."""
        return (self.short, *self.paths)


BUILTIN: Mapping[Kind, tuple[Builtin, ...]] = {
    "job": (
        Builtin(
            "orchestration",
            "rigel_k8s.jobs.types.orchestration:OrchestrationJob",
            ("rigel_k8s.OrchestrationPlugin", "src.plugin.OrchestrationPlugin"),
        ),
        Builtin(
            "dockerfile",
            "rigel_k8s.jobs.types.dockerfile:DockerfileJob",
            ("rigel_k8s.DockerfilePlugin", "rigel.plugins.core.DockerfilePlugin"),
        ),
        Builtin(
            "buildx",
            "rigel_k8s.jobs.types.buildx:BuildXJob",
            ("rigel_k8s.BuildXPlugin", "rigel.plugins.core.BuildXPlugin"),
        ),
        Builtin(
            "delivery",
            "rigel_k8s.jobs.types.delivery:DeliveryJob",
            ("rigel_k8s.DeliveryPlugin",),
        ),
        Builtin(
            "network",
            "rigel_k8s.jobs.types.network:NetworkJob",
            ("rigel_k8s.NetworkPlugin",),
        ),
        Builtin(
            "observability",
            "rigel_k8s.jobs.types.observability:ObservabilityJob",
            ("rigel_k8s.ObservabilityPlugin",),
        ),
        Builtin(
            "muto-agent",
            "rigel_muto.job:MutoAgentJob",
            ("rigel_k8s.MutoAgentPlugin",),
        ),
    ),
    "provider": (
        Builtin(
            "registry",
            "rigel_k8s.jobs.types.container_registry:ContainerRegistry",
            (
                "rigel_k8s.ContainerRegistryProvider",
                "rigel.providers.core.ContainerRegistryProvider",
            ),
        ),
    ),
}


def index_by_name(kind: Kind) -> dict[str, Builtin]:
    """Return this package's job types or providers under each of their names."""
    return {name: builtin for builtin in BUILTIN[kind] for name in builtin.names}
