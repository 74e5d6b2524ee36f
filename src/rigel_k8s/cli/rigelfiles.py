"""`rigel init`, `check` and `schema`."""

from __future__ import annotations

import sys

import click

from rigel_k8s.cli.width import WARNING, find_width, wrap
from rigel_k8s.cli.words import is_quiet, json_option, print_json, settings
from rigel_k8s.objects.text import plural


@click.command()
@click.option(
    "--ros",
    metavar="DISTRO",
    help="Write it for this distribution, or for ROS 1 or 2; default: your shell's, or 2.",
)
@click.option("--force", is_flag=True, help="Overwrite an existing Rigelfile.")
@click.pass_context
def init(ctx: click.Context, /, ros: str | None, force: bool) -> None:  # noqa: FBT001 - click passes it by name
    """Write a commented Rigelfile that passes `rigel check`."""
    from rigel_k8s.commands import rigelfiles as actions

    path = settings(ctx).rigelfile
    actions.init(path, ros=ros, force=force)
    click.echo(f"Wrote {path}. Next: edit it, `rigel check`, `rigel run sequence demo`.")


@click.command()
@json_option
@click.pass_context
def check(ctx: click.Context, /, output: str) -> int:
    """Report all problems of the Rigelfile, with their places. Exit code 2 if there is one."""
    from rigel_k8s.commands import rigelfiles as actions

    result = actions.check(settings(ctx))
    failed = bool(result.errors)
    if output == "json":
        print_json([finding_json(result.source.name, finding) for finding in result.findings])
        return 2 if failed else 0
    width = find_width(sys.stdout)
    for finding, text in zip(result.findings, result.render_findings(width), strict=True):
        color = WARNING if finding.severity == "warning" else "red"
        head, *snippet = text.splitlines()
        mark = click.style("warning:", fg=WARNING)
        click.echo(wrap(head, sys.stdout).replace("warning:", mark, 1))
        for line in snippet:
            click.secho(line, fg=color if line.lstrip(" |").startswith("^") else None)
    if not is_quiet(ctx):
        click.echo(f"{result.source.name}: {count(len(result.errors), len(result.warnings))}")
    return 2 if failed else 0


def count(errors: int, warnings: int) -> str:
    """Return how many problems a Rigelfile has."""
    if not errors and not warnings:
        return "no problems"
    parts = [plural(errors, "error") if errors else "no errors"]
    if warnings:
        parts.insert(0 if not errors else 1, plural(warnings, "warning"))
    return ", ".join(parts)


def finding_json(name: str, finding: object) -> dict[str, object]:
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
