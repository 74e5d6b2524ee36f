"""`rigel run job` and `rigel run sequence`."""

from __future__ import annotations

from typing import Literal

import click

from rigel_k8s.cli.words import Timeout, choose_reporter, complete_runnable, settings


@click.command()
@click.argument("kind", type=click.Choice(["job", "sequence"]))
@click.argument("name", shell_complete=complete_runnable)
@click.option("--timeout", type=Timeout(), help="How long a roll-out may take, 5m say.")
@click.option(
    "--adopt", is_flag=True, help="Take over what kubectl, helm or another tool had made."
)
@click.pass_context
def run(
    ctx: click.Context,
    /,
    kind: Literal["job", "sequence"],
    name: str,
    timeout: float | None,
    adopt: bool,  # noqa: FBT001 - click passes it by name
) -> None:
    """Run a job or a sequence of the Rigelfile."""
    from rigel_k8s.commands import run as runs

    with choose_reporter(ctx) as report:
        runs.run(kind, name, settings(ctx, timeout=timeout, adopt=adopt), report)
