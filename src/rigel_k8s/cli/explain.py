"""`rigel explain`."""

from __future__ import annotations

import click


@click.command()
@click.argument("kind", required=False)
def explain(kind: str | None) -> None:
    """Explain why a pod is not ready, what the checks of a network find, or a word of kubectl.

    KIND is the word in brackets behind a message, or one that `kubectl get pods` prints. Without
    it, lists all.
    """
    from rigel_k8s.commands import explain as explaining

    if kind is None:
        group = ""
        for one in explaining.list_kinds():
            if one.group != group:
                click.echo(f"{'' if not group else chr(10)}{one.group}")
                group = one.group
            click.echo(f"  {one.kind}: {one.cause}")
        return
    for number, one in enumerate(explaining.explain(kind)):
        if number:
            click.echo()
        click.echo(f"{one.kind} ({one.group})")
        click.echo(f"cause:  {one.cause}")
        if one.remedy:
            click.echo(f"remedy: {one.remedy}")
        if one.found_by:
            click.echo(f"found by: {one.found_by}")
