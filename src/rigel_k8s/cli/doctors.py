"""`rigel doctor`."""

from __future__ import annotations

import attrs
import click

from rigel_k8s.cli.words import json_option, print_json, settings


@click.command()
@json_option
@click.pass_context
def doctor(ctx: click.Context, /, output: str) -> int:
    """Check a deploy's needs: cluster, rights, nodes, storage. Exit code 1 if one is missing."""
    from rigel_k8s.commands import doctor as doctors

    findings = doctors.examine(settings(ctx))
    if output == "json":
        print_json([attrs.asdict(finding) for finding in findings])
    else:
        for finding in findings:
            mark = click.style("✓", fg="green") if finding.ok else click.style("✗", fg="red")
            click.echo(f"{mark} {finding.what}: {finding.found}")
            if not finding.ok and finding.hint:
                click.echo(f"    {finding.hint}")
    return 0 if all(finding.ok for finding in findings) else 1
