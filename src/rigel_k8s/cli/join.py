"""`rigel join`."""

from __future__ import annotations

import click

from rigel_k8s.cli.words import (
    Timeout,
    choose_reporter,
    complete_node,
    namespace_option,
    release_option,
    settings,
)


@click.command()
@click.option(
    "--like",
    metavar="NODE",
    shell_complete=complete_node,
    help="Have the image and the network of this node [default: any].",
)
@click.option(
    "--replace",
    "replaced",
    metavar="NODE",
    shell_complete=complete_node,
    help="Stop this node meanwhile, and start it again in the end.",
)
@release_option
@namespace_option
@click.option("--timeout", type=Timeout(), help="Wait at most this long for the pod [default: 1m].")
@click.argument("command", nargs=-1, type=click.UNPROCESSED, metavar="-- [COMMAND]...")
@click.pass_context
def join(
    ctx: click.Context,
    /,
    like: str | None,
    replaced: str | None,
    job: str | None,
    timeout: float | None,
    command: tuple[str, ...],
) -> int:
    """Run a program of this computer in the network of a release: rigel join -- rviz2.

    The program has the address of a pod, and the nodes see it as one of them. Without a command
    it is a shell.
    """
    from rigel_k8s.commands.join.session import join as run

    words = settings(ctx, timeout=timeout)
    with choose_reporter(ctx, plain=True) as report:
        return run(words, command, report, like=like, replaced=replaced, job=job)
