"""`rigel explain`."""

from __future__ import annotations

import click


@click.command()
@click.argument("kind", required=False)
def explain(kind: str | None) -> None:
    """Explain a kind of problem: the word in brackets behind a message.

    Prints the cause and the remedy. Without KIND, lists all kinds.
    """
    from rigel_k8s.commands import explain as explaining

    if kind is None:
        group = ""
        for one in explaining.list_kinds():
            if one.group != group:
                click.echo(f"{'' if not group else chr(10)}{one.group}")
                group = one.group
            click.echo(f"  {one.kind}")
        return
    for number, one in enumerate(explaining.explain(kind)):
        if number:
            click.echo()
        click.echo(f"{one.kind} ({one.group})")
        click.echo(f"cause:  {one.cause}")
        if one.remedy:
            click.echo(f"remedy: {one.remedy}")
