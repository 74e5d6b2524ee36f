"""`rigel render`, `diff`, `restart`, `history`, `rollback` and `down`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from rigel_k8s.cli.words import (
    Timeout,
    choose_reporter,
    complete_node,
    complete_sequence,
    data_option,
    is_quiet,
    job_argument,
    json_option,
    lock_timeout_option,
    namespace_option,
    print_json,
    release_argument,
    release_option,
    settings,
    warn,
)
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.objects.text import plural

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rigel_k8s.release.history import Entry
    from rigel_k8s.release.types import Plan, ReleaseId, Revision, Step


@click.command()
@job_argument
@data_option
@click.pass_context
def render(ctx: click.Context, /, job: str | None, data: dict[str, Any]) -> None:
    """Print the manifests that a job would apply, as YAML."""
    from rigel_k8s.commands import releases
    from rigel_k8s.release.difference import shorten_binary
    from rigel_k8s.yaml_text import documents

    found = releases.render(settings(ctx), job, data)
    warn(found.warnings)
    # A file or another program gets all of it; no one reads base64 in a terminal.
    whole = not sys.stdout.isatty()
    click.echo(documents(found.objects if whole else map(shorten_binary, found.objects)), nl=False)


@click.command()
@job_argument
@data_option
@click.option("--exit-code", is_flag=True, help="End with exit code 1 if there are differences.")
@click.option(
    "--adopt", is_flag=True, help="Take over fields of other tools, as `run --adopt` does."
)
@click.option(
    "--revision",
    "revisions",
    type=click.IntRange(1),
    multiple=True,
    metavar="N",
    help="Compare this revision with the newest one, or with a second one that is given.",
)
@click.pass_context
def diff(
    ctx: click.Context,
    /,
    job: str | None,
    data: dict[str, Any],
    exit_code: bool,  # noqa: FBT001 - click passes them by name
    adopt: bool,  # noqa: FBT001
    revisions: tuple[int, ...],
) -> int:
    """Show what a job would change on the cluster; nothing is written."""
    from rigel_k8s.commands import releases

    if len(revisions) > 2:
        raise UserError("--revision is given more than twice", hint="two revisions are compared")
    if revisions:
        newest = None if len(revisions) == 1 else revisions[1]
        text = releases.compare(settings(ctx), job, revisions[0], newest)
        print_difference(text)
        return 1 if exit_code and text else 0
    try:
        found = releases.diff(settings(ctx, adopt=adopt), job, data)
    except RigelK8sError as error:
        if exit_code and error.exit_code == 1:
            error.exit_code = 2  # 1 means that there are differences
        raise
    warn(found.warnings)
    print_difference(found.text)
    if not is_quiet(ctx):
        click.echo(summary(found.steps), err=True)
    if found.conflict is not None:
        found.conflict.exit_code = 2 if exit_code else found.conflict.exit_code
        raise found.conflict
    return 1 if exit_code and any(step.writes for step in found.steps) else 0


def print_difference(text: str) -> None:
    """Print a unified diff."""
    for line in text.splitlines():
        click.secho(line, fg=line_color(line))


def line_color(line: str) -> str | None:
    """Return the colour of a line of a unified diff."""
    if line.startswith(("+++", "---")):
        return None
    return {"+": "green", "-": "red", "@": "cyan"}.get(line[:1])


def summary(steps: Iterable[Step]) -> str:
    """Return how many objects are created, changed and pruned."""
    counts: dict[str, int] = {}
    for step in steps:
        counts[step.action] = counts.get(step.action, 0) + 1
    words = {
        "create": "to create",
        "change": "to change",
        "prune": "to delete",
        "keep": "unchanged",
    }
    changes = [f"{counts[action]} {text}" for action, text in words.items() if counts.get(action)]
    return ", ".join(changes) or "nothing to do"


@click.command()
@release_argument
@click.argument("number", required=False, type=click.IntRange(1))
@namespace_option
@json_option
@click.pass_context
def history(ctx: click.Context, /, job: str | None, number: int | None, output: str) -> None:
    """List the revisions of a release with what each changed, or show one by its NUMBER."""
    from datetime import datetime, timezone

    from rigel_k8s.cli.listing import STATES
    from rigel_k8s.cli.tables import age, table
    from rigel_k8s.commands import releases

    if number is None and job and job.isdigit():
        number, job = int(job), None
    if number is not None:
        show_revision(*releases.show(settings(ctx), job, number), output)
        return
    found, now = releases.history(settings(ctx), job), datetime.now(timezone.utc)
    if output == "json":
        columns = ("number", "status", "created", "by", "description", "images", "changes")
        print_json([{name: getattr(one, name) for name in columns} for one in found])
    elif found:
        heads = ["REVISION", "STATUS", "AGE", "BY", "DESCRIPTION", "IMAGE", "CHANGES"]
        cells = [
            [
                str(one.number),
                one.status,
                age(one.created, now),
                one.by or "-",
                one.description,
                ", ".join(one.images) or "-",
                "; ".join(one.changes) or "-",
            ]
            for one in found
        ]
        colors = [STATES.get(one.status) for one in found]
        click.echo(table(heads, cells, ("IMAGE", "DESCRIPTION", "BY"), colors, wrapped=True))
    else:
        click.echo("no revisions: nothing was deployed", err=True)


def show_revision(entry: Entry, revision: Revision, output: str) -> None:
    """Print one revision: who made it, what it changed, and the options of its job."""
    from rigel_k8s.yaml_text import document

    notes = {
        "revision": entry.number,
        "status": entry.status,
        "created": entry.created,
        "by": entry.by,
        "description": entry.description,
        "images": list(entry.images),
        "changes": list(entry.changes),
        "failure": revision.failure,
        "folder": revision.source,
    }
    whole = {**{key: value for key, value in notes.items() if value}, "with": revision.options}
    if output == "json":
        print_json(whole)
    else:
        click.echo(document(whole), nl=False)


@click.command()
@click.argument("nodes", nargs=-1, metavar="NODE...", required=True, shell_complete=complete_node)
@release_option
@namespace_option
@click.option(
    "--timeout", type=Timeout(), help="Wait at most this long for the new pods, for example 5m."
)
@lock_timeout_option
@click.pass_context
def restart(
    ctx: click.Context,
    /,
    nodes: tuple[str, ...],
    job: str | None,
    timeout: float | None,
    lock_timeout: float | None,
) -> None:
    """Replace the pods of ROS nodes by new ones of the same version, and wait for them.

    They are replaced as in an update: a node that hands over does so here, too. A task runs again.
    """
    from rigel_k8s.commands import releases, targets

    words = settings(ctx, timeout=timeout, lock_timeout=lock_timeout)
    found = targets.release(words, job, nodes)
    with choose_reporter(ctx) as report:
        releases.restart(found, words, nodes, report)


@click.command()
@click.argument("revision", required=False, type=click.IntRange(min=1))
@release_option
@namespace_option
@click.option(
    "--timeout", type=Timeout(), help="Wait at most this long for the roll-out, for example 5m."
)
@lock_timeout_option
@click.option(
    "--adopt", is_flag=True, help="Take over fields of other tools, as `run --adopt` does."
)
@click.pass_context
def rollback(
    ctx: click.Context,
    /,
    revision: int | None,
    job: str | None,
    timeout: float | None,
    lock_timeout: float | None,
    adopt: bool,  # noqa: FBT001 - click passes it by name
) -> None:
    """Deploy an earlier revision again; without a number, the last good one before the current.

    An interrupted rollback is finished first.
    """
    from rigel_k8s.commands import releases, targets

    words = settings(ctx, timeout=timeout, adopt=adopt, lock_timeout=lock_timeout)
    found = targets.release(words, job, named=True)
    with choose_reporter(ctx) as report:
        new = releases.rollback(found, words, revision, report)
    click.echo(f"revision {new.number}: {new.description}")


@click.command()
@release_argument
@namespace_option
@click.option(
    "--sequence",
    metavar="NAME",
    help="Delete all releases that this sequence deploys, ten at the same time.",
    shell_complete=complete_sequence,
)
@click.option("--volumes", is_flag=True, help="Delete claims and volumes, too; their data is lost.")
@click.option("-y", "--yes", is_flag=True, help="Do not ask.")
@click.option("--timeout", type=Timeout(), help="Wait at most this long, for example 5m.")
@lock_timeout_option
@click.pass_context
def down(
    ctx: click.Context,
    /,
    job: str | None,
    sequence: str | None,
    volumes: bool,  # noqa: FBT001 - click passes them by name
    yes: bool,  # noqa: FBT001
    timeout: float | None,
    lock_timeout: float | None,
) -> None:
    """Delete a release. Its claims and volumes stay unless --volumes.

    In a terminal it asks before, unless -y.
    """
    if job and sequence:
        raise click.UsageError("name either a job or a sequence", ctx)
    words = settings(ctx, timeout=timeout, lock_timeout=lock_timeout)
    if sequence:
        from rigel_k8s.commands import fleet

        confirm(f"all releases of the sequence {sequence}", volumes=volumes, yes=yes)
        with choose_reporter(ctx) as report:
            removed = fleet.down(words, sequence, report, volumes=volumes)
    else:
        from rigel_k8s.commands import releases, targets

        found = targets.release(words, job, named=True)
        confirm(f"{found.id.name} from {found.id.namespace}", volumes=volumes, yes=yes)
        with choose_reporter(ctx) as report:
            removed = [(found.id, releases.down(found, words, report, volumes=volumes))]
    for release, plan in removed:
        click.echo(describe_removal(release, plan))


def describe_removal(release: ReleaseId, plan: Plan) -> str:
    """Return in one line what was deleted of a release."""
    where = f"{release.name} from {release.namespace}"
    if plan.is_empty:
        return f"there is no release {release.name} in the namespace {release.namespace}"
    if not plan.steps:
        return f"removed the records of {where}: {', '.join(map(str, plan.records))}"
    deleted = sum(step.action == "prune" for step in plan.steps)
    kept = [step.ref.name for step in plan.steps if step.action == "forget"]
    names = f"{', '.join(kept)} (--volumes deletes {'it' if len(kept) == 1 else 'them'})"
    left = f", {len(kept)} kept for its data: {names}" if kept else ""
    return f"removed {where}: {plural(deleted, 'object')} deleted{left}"


def confirm(what: str, *, volumes: bool, yes: bool) -> None:
    """Ask for confirmation in a terminal; without it, end with exit code 1.

    Raises:
        UserError: data would be deleted, and there is no terminal.
        click.Abort: Ctrl-C or Ctrl-D.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        if volumes:
            raise UserError(
                "--volumes deletes data, and there is no terminal to ask", hint="confirm with -y"
            )
        return
    data = ", its volumes and all their data" if volumes else ""
    if not click.confirm(f"Delete {what}{data}?", err=True):
        click.echo("nothing was deleted", err=True)
        raise click.exceptions.Exit(1)
