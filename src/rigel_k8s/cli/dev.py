"""`rigel dev`."""

from __future__ import annotations

import click

from rigel_k8s import signals
from rigel_k8s.cli.pods import CONTROLS
from rigel_k8s.cli.words import (
    Timeout,
    choose_reporter,
    complete_node,
    lock_timeout_option,
    namespace_option,
    release_option,
    settings,
)
from rigel_k8s.errors import UserError


@click.command()
@click.argument("node", shell_complete=complete_node)
@click.option(
    "--sync",
    "synced",
    metavar="DIR:PATH",
    multiple=True,
    help="Copy the files of this folder to PATH in the container as they change; repeatable.",
)
@release_option
@namespace_option
@click.option("--timeout", type=Timeout(), help="Wait at most this long for a pod, for example 5m.")
@lock_timeout_option
@click.argument("command", nargs=-1, type=click.UNPROCESSED, metavar="-- [COMMAND]...")
@click.pass_context
def dev(
    ctx: click.Context,
    /,
    node: str,
    synced: tuple[str, ...],
    job: str | None,
    timeout: float | None,
    lock_timeout: float | None,
    command: tuple[str, ...],
) -> int:
    """Run a ROS node with the files of this computer, until Ctrl-C.

    Each change is copied into the node's container, and its program starts again in the same pod:
    rigel dev talker --sync src/talker:/ws/src/talker -- colcon build. The command runs there
    before; if it fails, the program goes on. At the end the release's version runs again.
    """
    from rigel_k8s.commands.dev.files import check_size, read_folder
    from rigel_k8s.commands.dev.session import develop

    if not synced:
        raise UserError("no folder to copy", hint="add --sync DIR:PATH")
    folders = [read_folder(text) for text in synced]
    check_size(folders)
    words = settings(ctx, timeout=timeout, lock_timeout=lock_timeout)
    with choose_reporter(ctx, plain=True) as report:
        develop(
            words, node, folders, command, report, lambda t: click.echo(CONTROLS.sub("", t)), job
        )
    return signals.exit_code()
