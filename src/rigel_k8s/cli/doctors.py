"""`rigel doctor`."""

from __future__ import annotations

import click

from rigel_k8s.cli.width import WARNING
from rigel_k8s.cli.words import json_option, print_json, settings
from rigel_k8s.problems import Problem


@click.command()
@json_option
@click.pass_context
def doctor(ctx: click.Context, /, output: str) -> int:
    """Check a deploy's needs, and the machines' clocks. Exit code 1 if a need is missing."""
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
            click.echo(f"{mark(need.problem)} {need.what}: {need.state}")
            if need.problem and need.problem.remedy:
                click.echo(f"    {need.problem.remedy}")
    return 1 if any(need.problem and need.problem.is_error for need in needs) else 0


def mark(problem: Problem | None) -> str:
    """Return the sign of a line; a warning stops no deploy."""
    if problem is None:
        return click.style("✓", fg="green")
    return click.style("✗", fg="red") if problem.is_error else click.style("!", fg=WARNING)
