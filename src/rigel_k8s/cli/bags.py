"""`rigel bags`."""

from __future__ import annotations

import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rigel_k8s.cli.words import (
    Group,
    choose_reporter,
    is_quiet,
    json_option,
    namespace_option,
    print_json,
    release_argument,
    release_option,
    settings,
)
from rigel_k8s.errors import UserError

if TYPE_CHECKING:
    from rigel_k8s.commands.bags import Bag

HEADS = ("BAG", "STARTED", "LENGTH", "SIZE", "STATE")
COLORS = {"recording": "green", "damaged": "red"}


@click.group(cls=Group)
def bags() -> None:
    """The bags that a release has recorded, by the option `record` of its job."""


@bags.command("list")
@release_argument
@namespace_option
@json_option
@click.pass_context
def list_(ctx: click.Context, /, job: str | None, output: str) -> None:
    """List the bags, the oldest first."""
    from rigel_k8s.cli.tables import table
    from rigel_k8s.commands import bags as commands

    found = commands.list_bags(settings(ctx), job)
    if output == "json":
        print_json([bag_json(bag) for bag in found])
    elif found:
        rows = [[b.name, stamp(b.started), length(b.seconds), size(b.size), b.state] for b in found]
        click.echo(table(HEADS, rows, colors=[COLORS.get(bag.state) for bag in found]))
    elif not is_quiet(ctx):
        click.echo("no bags yet", err=True)


@bags.command()
@click.argument("names", nargs=-1, metavar="[BAG]...")
@click.option(
    "--to",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    help="Copy into this folder [default: the current one].",
)
@click.option("--last", type=click.IntRange(min=1), help="Copy so many of the newest bags.")
@release_option
@namespace_option
@click.pass_context
def fetch(
    ctx: click.Context, /, names: tuple[str, ...], to: Path, last: int | None, job: str | None
) -> None:
    """Copy bags to this computer; all closed ones if you name none.

    A bag that is there already is not copied again. The one that is being written is copied only
    if you name it.
    """
    from rigel_k8s.commands import bags as commands

    if names and last:
        raise click.UsageError("either name bags, or use --last", ctx)
    with choose_reporter(ctx) as report:
        found = commands.fetch(settings(ctx), job, names, last, to, report)
    if not found and not is_quiet(ctx):
        click.echo("no closed bags yet", err=True)


@bags.command()
@click.argument("names", nargs=-1, metavar="[BAG]...")
@click.option("--all", "everything", is_flag=True, help="Delete all bags that are closed.")
@click.option("-y", "--yes", is_flag=True, help="Do not ask for confirmation.")
@release_option
@namespace_option
@click.pass_context
def delete(
    ctx: click.Context,
    /,
    names: tuple[str, ...],
    everything: bool,  # noqa: FBT001 - click passes them by name
    yes: bool,  # noqa: FBT001
    job: str | None,
) -> None:
    """Delete bags from the volume; in a terminal it asks before, unless -y.

    The one that is being written cannot be deleted.
    """
    from rigel_k8s.commands import bags as commands

    if bool(names) == everything:
        raise click.UsageError("name bags, or use --all", ctx)
    if not yes and not sys.stdin.isatty():
        raise UserError("bags are data, and there is no terminal to ask", hint="confirm with -y")
    recorder = commands.open_recorder(settings(ctx), job)
    with recorder.found.cluster:
        there = recorder.list()
        chosen = commands.choose(there, names)
        if everything:
            chosen = [bag for bag in there if bag.state not in commands.UNFINISHED]
        total = size(sum(bag.size for bag in chosen))
        what = chosen[0].name if len(chosen) == 1 else f"{len(chosen)} bags"
        if chosen and not yes and not click.confirm(f"Delete {what} ({total})?", err=True):
            click.echo("nothing was deleted", err=True)
            raise click.exceptions.Exit(1)
        commands.delete(recorder, chosen)
    click.echo(f"deleted {what} ({total})" if chosen else "no closed bags")


def stamp(started: float | None) -> str:
    """Return a time for people, in UTC as in logs."""
    if started is None:
        return "-"
    return datetime.fromtimestamp(started, timezone.utc).strftime("%Y-%m-%d %H:%M:%SZ")


def length(seconds: float | None) -> str:
    """Return a duration: 42s, 5m00s, 1h02m."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60}h{minutes % 60:02}m"
    return f"{minutes}m{rest:02}s" if minutes else f"{rest}s"


def size(count: int) -> str:
    """Return a number of bytes: 12 KiB, 3.4 MiB."""
    value, unit = float(count), "B"
    for larger in ("KiB", "MiB", "GiB", "TiB"):
        if value < 1024:
            break
        value, unit = value / 1024, larger
    return f"{value:.1f} {unit}" if value < 10 and unit != "B" else f"{value:.0f} {unit}"


def bag_json(bag: Bag) -> dict[str, Any]:
    """Return a bag for scripts (docs/cli.md)."""
    return {
        "bag": bag.name,
        "started": None if bag.started is None else stamp(bag.started).replace(" ", "T"),
        "seconds": bag.seconds,
        "size": bag.size,
        "state": bag.state,
    }
