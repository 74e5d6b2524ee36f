"""`rigel init`, `check` and `schema`."""

from __future__ import annotations

import sys

import click

from rigel_k8s.cli.width import find_width
from rigel_k8s.cli.words import is_quiet, json_option, print_json, settings


@click.command()
@click.option(
    "--ros",
    type=click.Choice(["1", "2"]),
    default="1",
    show_default=True,
    help="Write it for this version of ROS.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing Rigelfile.")
@click.pass_context
def init(ctx: click.Context, /, ros: str, force: bool) -> None:  # noqa: FBT001 - click passes it by name
    """Write a commented Rigelfile that passes `rigel check`."""
    from rigel_k8s.commands import rigelfiles as actions

    path = settings(ctx).rigelfile
    actions.init(path, ros=ros, force=force)
    click.echo(f"Wrote {path}. Next: edit it, `rigel check`, `rigel run sequence demo`.")


@click.command()
@click.option("--rigel03", is_flag=True, help="Report also what Rigel 0.3 does not accept.")
@json_option
@click.pass_context
def check(ctx: click.Context, /, rigel03: bool, output: str) -> int:  # noqa: FBT001 - see init
    """Report all problems of the Rigelfile, with their places. Exit code 2 if there is one."""
    from rigel_k8s.commands import rigelfiles as actions

    results = [actions.check(settings(ctx))]
    if rigel03:
        results.append(actions.check_rigel03(settings(ctx)))
    failed = any(result.errors for result in results)
    if output == "json":
        print_json([finding_json(r.source.name, f) for r in results for f in r.findings])
        return 2 if failed else 0
    width = find_width(sys.stdout)
    for text in dict.fromkeys(text for result in results for text in result.render_findings(width)):
        click.echo(text)
    if not failed and not is_quiet(ctx):
        click.echo(f"{results[0].source.name}: no problems")
    return 2 if failed else 0


def finding_json(name: str, finding: object) -> dict[str, object]:
    """Return a finding for scripts."""
    from rigel_k8s.rigelfile import Finding

    assert isinstance(finding, Finding)
    return {
        "file": finding.source.name if finding.source else name,
        "line": finding.span.line,
        "column": finding.span.column,
        "message": finding.message,
        "kind": finding.kind,
        "severity": finding.severity,
    }


@click.command()
def schema() -> None:
    """Print a JSON schema of Rigelfiles.

    For VS Code's YAML extension: rigel schema > rigelfile.schema.json, and add the file to
    "yaml.schemas".
    """
    from rigel_k8s.commands import rigelfiles as actions

    print_json(actions.schema())
