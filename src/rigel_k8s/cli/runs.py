"""`rigel run`."""

from __future__ import annotations

import click

from rigel_k8s.cli.words import (
    choose_reporter,
    lock_timeout_option,
    namespace_option,
    runnable_argument,
    settings,
    split_runnable,
    timeout_option,
)


@click.command()
@runnable_argument
@timeout_option
@namespace_option
@lock_timeout_option
@click.option(
    "--rollback-on-failure",
    is_flag=True,
    help="Go back to the last good revision if a roll-out fails; not if only the check of DDS"
    " discovery after it does.",
)
@click.option("--now", is_flag=True, help="Do not wait until the robot is idle.")
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
    now: bool,  # noqa: FBT001
    adopt: bool,  # noqa: FBT001
) -> None:
    """Run a job or a sequence of the Rigelfile.

    The word before NAME is needed only where a job and a sequence have the same name.
    """
    from rigel_k8s.commands import run as runs

    kind, name = split_runnable(ctx, words)
    with choose_reporter(ctx) as report:
        chosen = settings(
            ctx,
            timeout=timeout,
            adopt=adopt,
            lock_timeout=lock_timeout,
            rollback_on_failure=rollback_on_failure,
            now=now,
        )
        runs.run(kind, name, chosen, report)
