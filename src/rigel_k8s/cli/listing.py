"""`rigel list`."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

import click

from rigel_k8s.cli.width import WARNING
from rigel_k8s.cli.words import is_quiet, json_option, namespace_option, print_json, settings
from rigel_k8s.objects.text import join_words
from rigel_k8s.release.listing import ReleaseSummary

#: Of revisions that are not good.
STATES = {"failed": "red", "pending": WARNING, "interrupted": WARNING}
HEADS = ("NAME", "REVISION", "STATUS", "READY", "AGE", "JOB", "RIGEL")


@click.command("list")
@namespace_option
@click.option("-A", "--all-namespaces", is_flag=True, help="List the releases of all namespaces.")
@json_option
@click.pass_context
def list_(ctx: click.Context, /, all_namespaces: bool, output: str) -> None:  # noqa: FBT001
    """List the releases of a namespace or of the whole cluster; no Rigelfile is needed.

    Without -n and -A, the namespace is that of the Rigelfile, or else that of the context.
    READY counts workloads, AGE is the age of the newest revision, JOB is the job that made it.
    """
    from rigel_k8s.commands import status

    namespaces, found = status.releases(settings(ctx), everywhere=all_namespaces)
    if output == "json":
        print_json([summary_json(one) for one in found])
    elif found:
        several = all_namespaces or len(namespaces) > 1
        click.echo(summary_table(found, datetime.now(timezone.utc), everywhere=several))
    elif not is_quiet(ctx):
        where = f"the namespace{'s' if len(namespaces) > 1 else ''} {join_words(namespaces)}"
        rest = f"{where}; `rigel list -A` lists those of all namespaces"
        click.echo(f"no releases in {rest if namespaces else 'the cluster'}", err=True)


def summary_table(found: Sequence[ReleaseSummary], now: datetime, *, everywhere: bool) -> str:
    from rigel_k8s.cli.tables import age, table

    rows = [
        [
            *([one.release.namespace] if everywhere else []),
            one.release.name,
            str(one.revision),
            one.status,
            f"{one.ready}/{one.workloads}",
            age(one.updated, now),
            one.description or "-",
            one.tool_version or "-",
        ]
        for one in found
    ]
    colors = [STATES.get(one.status) for one in found]
    return table([*(["NAMESPACE"] if everywhere else []), *HEADS], rows, colors=colors)


def summary_json(one: ReleaseSummary) -> dict[str, Any]:
    """Return a release's line for scripts (docs/cli.md)."""
    return {
        "release": one.release.name,
        "namespace": one.release.namespace,
        "revision": one.revision,
        "revision_status": one.status,
        "ready": one.ready,
        "workloads": one.workloads,
        "updated": one.updated,
        "description": one.description,
        "tool_version": one.tool_version,
    }
