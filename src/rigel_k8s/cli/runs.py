"""`rigel run`."""

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
@click.argument(
    "words",
    nargs=-1,
    required=True,
    metavar="[job|sequence] NAME",
    shell_complete=complete_runnable,
)
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
    words: tuple[str, ...],
    timeout: float | None,
    lock_timeout: float | None,
    rollback_on_failure: bool,  # noqa: FBT001 - click passes them by name
    adopt: bool,  # noqa: FBT001
) -> None:
    """Run a job or a sequence of the Rigelfile.

    The word before NAME is needed only where a job and a sequence have the same name.
    """
    from rigel_k8s.commands import run as runs

    kind: Literal["job", "sequence"] | None = None
    match words:
        case [name]:
            pass
        case ["job" | "sequence" as kind, name]:
            pass
        case _:
            raise click.UsageError("name one job or one sequence", ctx)
    with choose_reporter(ctx) as report:
        chosen = settings(
            ctx,
            timeout=timeout,
            adopt=adopt,
            lock_timeout=lock_timeout,
            rollback_on_failure=rollback_on_failure,
        )
        runs.run(kind, name, chosen, report)
