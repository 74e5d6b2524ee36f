"""`rigel test`."""

from __future__ import annotations

from pathlib import Path

import click

from rigel_k8s.cli.words import (
    Timeout,
    choose_reporter,
    namespace_option,
    runnable_argument,
    settings,
    split_runnable,
    timeout_option,
)

COLORS = {"failed": "red", "unknown": "yellow"}


@click.command()
@runnable_argument
@namespace_option
@timeout_option
@click.option(
    "--within",
    type=Timeout(),
    default="5m",
    help="Give each test so long, and topics to become as expected [default: 5m].",
)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("test-results"),
    help="Put logs, files of tests, bags and rigel.xml (JUnit) into this folder"
    " [default: test-results].",
)
@click.option("--keep", is_flag=True, help="Delete nothing in the end.")
@click.option("--repeat", type=click.IntRange(1), default=1, metavar="N", help="Do it N times.")
@click.option("--parallel", type=click.IntRange(1), default=1, metavar="K", help="K runs at once.")
@click.pass_context
def test(
    ctx: click.Context,
    /,
    words: tuple[str, ...],
    timeout: float | None,
    within: float,
    output: Path,
    keep: bool,  # noqa: FBT001 - click passes it by name
    repeat: int,
    parallel: int,
) -> int:
    """Deploy a job or a sequence, run its tests, and delete it.

    Without -n it makes a namespace, and deletes that in the end. Its tests are its nodes of
    `kind: test`, and what it expects of topics (`expect`). Exit code 1 if one fails. With --repeat
    it counts how often each passes.
    """
    from rigel_k8s.cli.tables import table
    from rigel_k8s.commands.testing.repeating import repeat_tests
    from rigel_k8s.commands.testing.results import RUN
    from rigel_k8s.commands.testing.run import Trial, run_tests

    kind, name = split_runnable(ctx, words)
    if parallel > 1 and repeat == 1:
        raise click.UsageError("--parallel is for several runs: add --repeat N", ctx)
    trial = Trial(kind, name, settings(ctx, timeout=timeout), within, output, keep)
    error = None
    with choose_reporter(ctx) as report:
        prepared = trial.prepare()
        for warning in prepared.warnings:
            report.warn(warning)
        if repeat == 1:
            found = [(str(one.state), one) for one in run_tests(trial, prepared, report)]
        else:
            found, error = repeat_tests(trial, prepared, report, times=repeat, width=parallel)
    rows = [
        [one.name, ended, f"{one.seconds:.1f}s" if one.seconds else "", one.message]
        for ended, one in found
    ]
    colors = [COLORS.get(one.state) for _, one in found]
    heads = ["STATE", "TIME"] if repeat == 1 else ["PASSED", "SLOWEST"]
    if not error or any(one.name != RUN for _, one in found):
        click.echo(table(["TEST", *heads, "CAUSE"], rows, colors=colors))
    if error:
        raise error
    return 1 if any(one.state == "failed" for _, one in found) else 0
