"""`rigel expect`: topics beside what the Rigelfile expects of them."""

from __future__ import annotations

import sys

import click

from rigel_k8s.cli.words import (
    Group,
    Timeout,
    json_option,
    namespace_option,
    print_json,
    release_option,
    settings,
)

COLORS = {"broken": "red", "unknown": "yellow"}


@click.group(cls=Group, invoke_without_command=True)
@release_option
@namespace_option
@json_option
@click.option(
    "--wait",
    type=Timeout(least=0),
    default=0.0,
    help="Give the nodes so long: compare again until nothing is broken [default: 0].",
)
@click.pass_context
def expect(ctx: click.Context, /, job: str | None, output: str, wait: float) -> int | None:
    """Compare the topics of a release with what was deployed as `expect`.

    Exit code 1 if something is not as expected. What was not measured is no such thing.
    """
    if ctx.invoked_subcommand is not None:
        ctx.obj = job
        return None
    from rigel_graph.commands.expect import examine
    from rigel_k8s.cli.tables import table

    found = examine(settings(ctx), job, wait)
    if output == "json":
        verdicts = [one.to_json() for one in found.verdicts]
        print_json({"release": found.release.name, "ok": found.ok, "verdicts": verdicts})
        return 0 if found.ok else 1
    rows, colors = [], []
    for one in found.verdicts:
        what, state, expected, measured = one.finding
        rows.append([one.topic, what, expected, measured, state])
        colors.append(COLORS.get(state))
    click.echo(table(["TOPIC", "", "EXPECTED", "MEASURED", "STATE"], rows, colors=colors))
    return 0 if found.ok else 1


@expect.command()
@click.option(
    "--for",
    "seconds",
    type=Timeout(),
    default="1m",
    help="Look at the running release for so long [default: 1m].",
)
@click.pass_context
def learn(ctx: click.Context, /, seconds: float) -> None:
    """Propose `expect` from what the topics of a running release do, with margins."""
    from rigel_graph.commands.expect import SETTLED
    from rigel_graph.commands.expect import learn as run
    from rigel_k8s.objects.text import join_words
    from rigel_k8s.yaml_text import document

    interactive = sys.stderr.isatty()

    def report(text: str) -> None:
        if interactive:
            click.echo(f"\r\033[K{text}", nl=False, err=True)

    found = run(settings(ctx), ctx.obj, seconds, report)
    report("")
    proposed = {name: one.propose() for name, one in found.items()}
    click.echo(document({"expect": proposed}), nl=False)
    rated = [name for name, made in proposed.items() if "rate" in made and "gap" not in made]
    if young := [name for name in rated if found[name].young]:
        click.echo(
            f"no gap is proposed for {join_words(young)}: the nodes began less than {SETTLED:.0f} s"
            " ago; learn it later",
            err=True,
        )
