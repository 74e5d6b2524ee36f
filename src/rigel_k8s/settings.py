"""What is set once for all jobs of a run; plain data that every package may read."""

from __future__ import annotations

from pathlib import Path

import attrs


@attrs.frozen
class Application:
    """The Rigelfile's `application`, with `dir` resolved against the Rigelfile's own directory."""

    distro: str
    dir: Path = Path()


@attrs.frozen
class Settings:
    """The global options of the command line, or of Muto's agent.

    Attributes:
        rigelfile: the Rigelfile's path.
        context: a context of the kubeconfig; None is its current one.
        kubeconfig: a kubeconfig file; None is $KUBECONFIG, then ~/.kube/config, then in-cluster.
        namespace: overrides the Rigelfile's and the context's; None: those.
        timeout: seconds that a roll-out may take; None is the job's own or the default.
        adopt: take over fields that another field manager owns.
        lock_timeout: seconds to wait for another deploy of the release; None: as `timeout`.
        rollback_on_failure: go back to the last good revision if a roll-out fails.
        now: do not wait until the robot is idle.
        tests: deploy nodes of `kind: test`, without pods.
        description: what `rigel history` shows of a deploy; None: the job's name.
    """

    rigelfile: Path = Path("Rigelfile")
    context: str | None = None
    kubeconfig: Path | None = None
    namespace: str | None = None
    timeout: float | None = None
    adopt: bool = False
    lock_timeout: float | None = None
    rollback_on_failure: bool = False
    now: bool = False
    tests: bool = False
    description: str | None = None
