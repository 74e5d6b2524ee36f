"""`rigel ui`: prints the address of the page, and what happens to the cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rigel_k8s.cli.words import Timeout, namespace_option, release_argument, settings

if TYPE_CHECKING:
    from collections.abc import Callable


@click.command()
@release_argument
@namespace_option
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Listen on this port of 127.0.0.1 [default: any free one].",
)
@click.option("--no-browser", is_flag=True, help="Print the address only; open no browser.")
@click.option(
    "--allow-changes",
    is_flag=True,
    help="Let the page roll back to an earlier revision, after a confirmation.",
)
@click.option(
    "--timeout",
    type=Timeout(),
    help="Wait at most this long for a rollback, for example 5m.",
)
@click.pass_context
def ui(
    ctx: click.Context,
    /,
    job: str | None,
    port: int,
    no_browser: bool,  # noqa: FBT001 - click passes them by name
    allow_changes: bool,  # noqa: FBT001
    timeout: float | None,
) -> None:
    """Show a release live in the browser, until Ctrl-C.

    The page shows the ROS graph, each node's state and cause, logs, the roll-out and the
    revisions. It is served on this machine only; its address contains a secret token.
    """
    from rigel_ui.serving import serve

    serve(
        settings(ctx, timeout=timeout),
        job,
        make_printer(),
        port=port,
        browser=not no_browser,
        allow_changes=allow_changes,
    )


def make_printer() -> Callable[[str], None]:
    """Return what prints lines: the address on standard output, everything else beside it."""
    lines = 0

    def report(text: str) -> None:
        nonlocal lines
        if lines == 0:
            click.echo(text)
            click.echo("Press Ctrl-C to end.", err=True)
        else:
            click.echo(text, err=True)
        lines += 1

    return report
