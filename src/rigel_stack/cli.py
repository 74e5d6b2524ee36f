"""`rigel observe`: opens the observability stack, shows its state, removes it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import attrs
import click

from rigel_k8s.cli.width import WARNING
from rigel_k8s.cli.words import Group, Timeout, choose_reporter, json_option, print_json, settings
from rigel_k8s.objects.text import plural

if TYPE_CHECKING:
    from rigel_stack.observing import Administrator, Opened
    from rigel_stack.status import ObserveStatus

PORT = click.IntRange(0, 65535)


@click.group(cls=Group, invoke_without_command=True)
@click.option(
    "--grafana", type=PORT, metavar="PORT", help="Use this local port for Grafana [default: 3000]."
)
@click.option(
    "--prometheus",
    type=PORT,
    metavar="PORT",
    help="Use this local port for Prometheus [default: 9090].",
)
@click.option(
    "--loki",
    type=PORT,
    metavar="PORT",
    help="Use this local port for Loki; 0 picks a free one [default: 3100].",
)
@click.option("--no-password", is_flag=True, help="Do not print Grafana's password.")
@json_option
@click.pass_context
def observe(
    ctx: click.Context,
    /,
    grafana: int | None,
    prometheus: int | None,
    loki: int | None,
    no_password: bool,  # noqa: FBT001 - click passes it by name
    output: str,
) -> None:
    """Open Grafana, Prometheus and Loki on this machine until Ctrl-C.

    Prints their addresses, and Grafana's user and password. If a default port is in use, another
    one is used. `observability: {enabled: true}` in a Rigelfile deploys the stack.
    """
    if ctx.invoked_subcommand is not None:
        return
    from rigel_stack import observing

    ports = {"grafana": grafana, "prometheus": prometheus, "loki": loki}
    for event in observing.observe(settings(ctx), ports, password=not no_password):
        if isinstance(event, str):
            click.echo(event, err=True)
        elif output == "json":
            print_json(attrs.asdict(event))
        else:
            show(event)
        sys.stdout.flush()


@observe.command()
@json_option
@click.pass_context
def status(ctx: click.Context, /, output: str) -> int:
    """Show whether the stack runs, answers and gets data, and which alerts fire.

    Exit code 1 if the stack itself is not in order.
    """
    from rigel_k8s.cli.status import status_json
    from rigel_k8s.commands.status import Status
    from rigel_stack import status as observe_status

    found = observe_status.status(settings(ctx))
    if output == "json":
        answers = [attrs.asdict(one) for one in found.answers]
        fire = [attrs.asdict(one) for one in found.alerts]
        state = status_json(Status(found.release))
        print_json({**state, "answers": answers, "alerts": fire, "ok": found.ok})
    else:
        show_status(found)
    return 0 if found.ok else 1


@observe.command()
@click.option("--volumes", is_flag=True, help="Delete its data and Grafana's password, too.")
@click.option("-y", "--yes", is_flag=True, help="Do not ask.")
@click.option("--timeout", type=Timeout(), help="Wait at most this long, for example 5m.")
@click.pass_context
def remove(
    ctx: click.Context,
    /,
    volumes: bool,  # noqa: FBT001 - click passes them by name
    yes: bool,  # noqa: FBT001
    timeout: float | None,
) -> None:
    """Remove the stack, for all applications. Its data stay unless --volumes."""
    from rigel_k8s.cli.releases import confirm
    from rigel_stack.removal import remove_installed

    confirm("the observability stack of all applications", volumes=volumes, yes=yes)
    with choose_reporter(ctx) as report:
        at = settings(ctx, timeout=timeout)
        gone, count, kept = remove_installed(at, report, volumes=volumes)
    left = f", {kept} kept for their data" if kept else ""
    deleted = f"{plural(count, 'object')} deleted"
    click.echo(f"removed the observability stack from {gone.namespace}: {deleted}{left}")


def show(opened: Opened) -> None:
    """Print the addresses of the parts."""
    from rigel_k8s.cli.tables import table

    who = login(opened.administrator)
    rows = [
        [name.capitalize(), url, who if name == "grafana" else ""]
        for name, url in opened.urls.items()
    ]
    closed = [[name.capitalize(), "-", reason] for name, reason in opened.closed.items()]
    click.echo(table([f"in {opened.namespace}", "", ""], [*rows, *closed]))
    click.echo("Press Ctrl-C to stop.", err=True)


def login(administrator: Administrator | None) -> str:
    if administrator is None:
        return ""
    if administrator.why_not:
        return administrator.why_not
    return f"user {administrator.user}, password {administrator.password}"


def show_status(found: ObserveStatus) -> None:
    """Print a status as text."""
    from rigel_k8s.cli.status import status_text
    from rigel_k8s.cli.tables import table
    from rigel_k8s.commands.status import Status

    click.echo(status_text(Status(found.release)))
    order = {True: "yes", False: "NO", None: "-"}
    rows = [[one.name, order[one.ok], one.said] for one in found.answers]
    click.echo("\n" + table(["PART", "IN ORDER", ""], rows))
    for alert in found.alerts:
        about = ", ".join(f"{name} {value}" for name, value in sorted(alert.labels.items()))
        click.secho(f"\n{alert.name}: {alert.summary or about}", fg=WARNING, nl=False)
        click.echo(f"\n  since {alert.since}; {about}")
