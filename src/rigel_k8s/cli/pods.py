"""`rigel logs`, `exec` and `forward`."""

from __future__ import annotations

import json
import re
import sys
from typing import Any

import click

from rigel_k8s.cli.width import name_style
from rigel_k8s.cli.words import Timeout, complete_node, namespace_option, release_option, settings
from rigel_k8s.commands.logs.lines import LogLine, LogOptions, stamp
from rigel_k8s.observability.names import LEVELS

FOLLOWED = 10  # old lines of each pod before the new ones
#: What a line could do to a terminal beside its colors: set the title, move the cursor, overwrite.
CONTROLS = re.compile(
    r"\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)?"  # operating system commands
    r"|\x1b\[[0-?]*[ -/]*[@-ln-~]"  # control sequences except those of colors, which end with m
    r"|\x1b(?!\[)."
    r"|[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]"
)


@click.command()
@click.argument("nodes", nargs=-1, metavar="[NODE]...", shell_complete=complete_node)
@click.option(
    "-f", "--follow", is_flag=True, help="Print new lines and those of new pods until Ctrl-C."
)
@click.option(
    "--since",
    type=Timeout(),
    help="Print the lines of the last 30s, 5m, 1h, 2d ...; from Loki if it is installed.",
)
@click.option(
    "--level",
    type=click.Choice(LEVELS, case_sensitive=False),
    help="Print lines of this level and above; implies --since 1h.",
)
@click.option(
    "--tail",
    type=click.IntRange(min=0),
    help="Print this many last lines of each pod; with -f alone, 10.",
)
@click.option(
    "-p",
    "--previous",
    is_flag=True,
    help="Print the lines of the container before its last restart.",
)
@click.option("--timestamps", is_flag=True, help="Print the time of each line.")
@click.option(
    "-o",
    "--output",
    type=click.Choice(["text", "json"]),
    default="text",
    help="Print in this format.",
)
@release_option
@namespace_option
@click.pass_context
def logs(
    ctx: click.Context,
    /,
    nodes: tuple[str, ...],
    follow: bool,  # noqa: FBT001 - click passes them by name
    since: float | None,
    level: str | None,
    tail: int | None,
    previous: bool,  # noqa: FBT001
    timestamps: bool,  # noqa: FBT001
    output: str,
    job: str | None,
) -> None:
    """Print the logs of ROS nodes; of all nodes if you name none.

    Lines come by time, those of several nodes with the node's name before them, those of one node
    with the pod's once it has another pod. With --since or
    --level they come from the observability stack's Loki if it is installed, also those of deleted
    pods, without those of the last seconds.
    """
    from rigel_k8s.commands.logs.reading import logs as lines_of

    if follow and (since, level, tail) == (None, None, None):
        tail = FOLLOWED
    options = LogOptions(
        follow=follow,
        since=None if since is None else max(1, round(since)),
        tail=tail,
        previous=previous,
        level=level,
    )
    styles: dict[str, dict[str, Any]] = {}
    pods: dict[str, set[str]] = {}
    for line in lines_of(settings(ctx), nodes, options, job):
        if output == "json" and not line.note:
            click.echo(json.dumps(line_json(line)))
            continue
        style = styles.setdefault(line.workload, name_style(len(styles)))
        pods.setdefault(line.workload, set()).add(line.pod)
        name = line.workload
        if len(nodes) == 1 and not line.note:
            name = line.pod if len(pods[name]) > 1 else ""
        prefix = click.style(f"[{name}] ", **style) if name else ""
        click.echo(prefix + text_of(line, timestamps=timestamps), err=line.note)


def text_of(line: LogLine, *, timestamps: bool) -> str:
    text = CONTROLS.sub("", line.text)
    return f"{stamp(line.time)} {text}" if timestamps and line.time else text


def line_json(line: LogLine) -> dict[str, str | None]:
    """Return a line for scripts (docs/cli.md)."""
    return {
        "time": stamp(line.time) if line.time else None,
        "level": line.level or None,
        "workload": line.workload,
        "ros_name": line.ros_node or None,
        "pod": line.pod,
        "node": line.node or None,
        "text": line.text,
    }


@click.command("exec", context_settings={"ignore_unknown_options": True})
@click.argument("node", shell_complete=complete_node)
@click.option("-i", "--stdin", is_flag=True, help="Pass standard input to the command.")
@click.option("-t", "--tty", is_flag=True, help="Give the command a terminal.")
@release_option
@click.argument("command", nargs=-1, type=click.UNPROCESSED, metavar="-- [COMMAND]...")
@click.pass_context
def exec_(
    ctx: click.Context,
    /,
    node: str,
    stdin: bool,  # noqa: FBT001 - click passes them by name
    tty: bool,  # noqa: FBT001
    job: str | None,
    command: tuple[str, ...],
) -> int:
    """Run a command in a ROS node's container, with ROS set up.

    rigel exec talker -- rostopic list; without a command, a shell (-it). The command's exit code
    becomes rigel's.
    """
    from rigel_k8s.commands import pods

    terminal = sys.stdin.isatty()
    if not command and not (stdin or tty):
        stdin, tty = True, terminal
    if tty and not terminal:
        click.echo("warning: standard input is not a terminal, so the command gets none", err=True)
    sys.stdout.flush()
    return pods.execute(
        settings(ctx),
        node,
        command,
        stdin=sys.stdin.buffer if stdin else None,
        stdout=sys.stdout.buffer,
        stderr=sys.stderr.buffer,
        tty=tty and terminal,
        job=job,
    )


def port_pair(text: str) -> tuple[int, int]:
    """Return (remote, local) of `PORT` or `LOCAL:REMOTE`, 0 for any local port (`:REMOTE`)."""
    local, _, remote = text.rpartition(":")
    if ":" not in text:
        local = remote
    try:
        pair = int(remote), int(local or 0)
    except ValueError:
        pair = 0, 0
    if not (0 < pair[0] < 65536 and 0 <= pair[1] < 65536):
        raise click.BadParameter(f'invalid port "{text}": use PORT, LOCAL:REMOTE or :REMOTE')
    return pair


@click.command()
@click.argument("node", shell_complete=complete_node)
@click.argument("ports", nargs=-1, metavar="[[LOCAL:]PORT]...")
@release_option
@namespace_option
@click.pass_context
def forward(ctx: click.Context, /, node: str, ports: tuple[str, ...], job: str | None) -> None:
    """Forward local ports to a ROS node's pod until Ctrl-C; without a port, the node's only one."""
    from rigel_k8s.commands import pods

    wanted = dict(port_pair(text) for text in ports)
    for text in pods.forward(settings(ctx), node, wanted, job):
        click.echo(text)
        sys.stdout.flush()
