"""`rigel doctor`."""

from __future__ import annotations

import click

from rigel_k8s.cli.words import json_option, print_json, settings


@click.command()
@json_option
@click.pass_context
def doctor(ctx: click.Context, /, output: str) -> int:
    """Check a deploy's needs: cluster, rights, nodes, storage. Exit code 1 if one is missing."""
    from rigel_k8s.commands import doctor as doctors

    needs = doctors.examine(settings(ctx))
    if output == "json":
        print_json(
            [
                {
                    "what": need.what,
                    "state": need.state,
                    "problem": need.problem and need.problem.to_json(),
                }
                for need in needs
            ]
        )
    else:
        for need in needs:
            mark = click.style("✗", fg="red") if need.problem else click.style("✓", fg="green")
            click.echo(f"{mark} {need.what}: {need.state}")
            if need.problem and need.problem.remedy:
                click.echo(f"    {need.problem.remedy}")
    return 1 if any(need.problem for need in needs) else 0
