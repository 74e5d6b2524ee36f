"""`rigel run job` and `rigel run sequence`."""

from __future__ import annotations

from typing import Literal

import click

from rigel_k8s.cli.words import (
    Timeout,
    choose_reporter,
    complete_runnable,
    lock_timeout_option,
    settings,
)


@click.command()
@click.argument("kind", type=click.Choice(["job", "sequence"]))
@click.argument("name", shell_complete=complete_runnable)
@click.option(
    "--timeout", type=Timeout(), help="Wait at most this long for a roll-out, for example 5m."
)
@lock_timeout_option
@click.option(
    "--rollback-on-failure",
    is_flag=True,
    help="Go back to the last good revision if a roll-out fails; not if only the check of DDS"
    " discovery after it does.",
)
@click.option(
    "--adopt", is_flag=True, help="Take over objects that kubectl, helm or another tool made."
)
@click.pass_context
def run(
    ctx: click.Context,
    /,
    kind: Literal["job", "sequence"],
    name: str,
    timeout: float | None,
    lock_timeout: float | None,
    rollback_on_failure: bool,  # noqa: FBT001 - click passes them by name
    adopt: bool,  # noqa: FBT001
) -> None:
    """Run a job or a sequence of the Rigelfile."""
    from rigel_k8s.commands import run as runs

    with choose_reporter(ctx) as report:
        chosen = settings(
            ctx,
            timeout=timeout,
            adopt=adopt,
            lock_timeout=lock_timeout,
            rollback_on_failure=rollback_on_failure,
        )
        runs.run(kind, name, chosen, report)
