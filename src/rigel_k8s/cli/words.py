"""What several commands have in common: the settings, durations, JSON on standard output."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from rigel_k8s.settings import Settings

if TYPE_CHECKING:
    from rigel_k8s.jobs.job import JobReporter


def settings(
    ctx: click.Context,
    *,
    timeout: float | None = None,
    adopt: bool = False,
    lock_timeout: float | None = None,
    rollback_on_failure: bool = False,
    now: bool = False,
) -> Settings:
    """Return the global options as Settings."""
    words = ctx.find_root().obj
    return Settings(
        rigelfile=words["rigelfile"],
        context=words["context"],
        kubeconfig=words["kubeconfig"],
        namespace=words["namespace"],
        timeout=timeout,
        adopt=adopt,
        lock_timeout=lock_timeout,
        rollback_on_failure=rollback_on_failure,
        now=now,
    )


def is_quiet(ctx: click.Context) -> bool:
    """Return whether -q was given."""
    return bool(ctx.find_root().obj["quiet"])


def choose_reporter(
    ctx: click.Context, *, plain: bool = False
) -> AbstractContextManager[JobReporter]:
    """Return the reporter for the options and the terminal.

    Args:
        plain: print lines only, since another program writes to the terminal, too.
    """
    from rigel_k8s.cli.reports import reporter

    words = ctx.find_root().obj
    plain = plain or words["verbose"] or ctx.find_root().color is False
    return reporter(quiet=words["quiet"], plain=plain)


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error."""
    for text in warnings:
        click.echo(text, err=True)


class Timeout(click.ParamType):  # type: ignore[type-arg]  # generic from click 8.4 on only
    """A duration such as 90, 90s, 5m, 1h or 7d, as seconds."""

    name = "duration"

    def __init__(self, *, least: float = 1e-9) -> None:
        self.least = least

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        if isinstance(value, int | float):
            return float(value)
        units = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
        number, unit = (value[:-1], value[-1]) if value[-1:] in units else (value, "s")
        try:
            seconds = float(number) * units[unit]
        except ValueError:
            seconds = -1.0
        if not self.least <= seconds < 1e9:
            self.fail(f'invalid duration "{value}": use 90s, 5m, 1h or 7d', param, ctx)
        return seconds


class Group(click.Group):
    """A group whose help has the first sentence of each command in full, on two lines if needed."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table; click would cut sentences where the line ends."""
        with formatter.section("Commands"):
            names = self.list_commands(ctx)
            found = [(name, self.get_command(ctx, name)) for name in names]
            formatter.write_dl([(n, one.get_short_help_str(1000)) for n, one in found if one])


json_option = click.option(
    "-o",
    "--output",
    type=click.Choice(["table", "json"]),
    default="table",
    help="Print in this format.",
)


def print_json(data: Any) -> None:
    click.echo(json.dumps(data, indent=2, default=str))


def make_completion(
    module: str, find: Callable[[Any, Settings, click.Context], Sequence[str]]
) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return a shell's completion of names, which must not fail.

    Args:
        module: of commands/, imported when it is needed.
        find: takes the module, the settings, and the context of the words before.
    """

    def complete(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
        from importlib import import_module

        from rigel_k8s.errors import RigelK8sError

        known = Settings(rigelfile=Path(ctx.find_root().params.get("rigelfile") or "Rigelfile"))
        try:
            names = find(import_module(f"rigel_k8s.commands.{module}"), known, ctx)
        except RigelK8sError:
            return []
        return [name for name in names if name.startswith(incomplete)]

    return complete


def list_runnable(rigelfiles: Any, settings: Settings, ctx: click.Context) -> list[str]:
    """Return the Rigelfile's jobs and sequences, or those of the kind before."""
    words = ctx.params.get("words") or ()
    kinds = list(words[:1]) or ["job", "sequence"]
    names = [name for kind in kinds for name in rigelfiles.list_runnable(settings, kind)]
    return names if words else [*kinds, *names]


def split_runnable(
    ctx: click.Context, words: tuple[str, ...]
) -> tuple[Literal["job", "sequence"] | None, str]:
    """Return what `[job|sequence] NAME` names; the first is None if it is not written."""
    match words:
        case [name]:
            return None, name
        case ["job" | "sequence" as kind, name]:
            return kind, name
        case _:
            raise click.UsageError("name one job or one sequence", ctx)


complete_job = make_completion("targets", lambda targets, s, _: targets.names(s))
complete_release = make_completion(
    "targets", lambda targets, s, _: targets.names(s, targets.HasRelease)
)
complete_node = make_completion(
    "targets", lambda targets, s, ctx: targets.node_names(s, ctx.params.get("job"))
)
complete_runnable = make_completion("rigelfiles", list_runnable)
complete_sequence = make_completion(
    "rigelfiles", lambda rigelfiles, s, _: rigelfiles.list_runnable(s, "sequence")
)


def choose_namespace(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Handle a namespace after the command as if it came before it."""
    if value is not None:
        ctx.find_root().obj["namespace"] = value


timeout_option = click.option(
    "--timeout", type=Timeout(), help="Wait at most this long for a roll-out, for example 5m."
)
lock_timeout_option = click.option(
    "--lock-timeout",
    type=Timeout(least=0.0),
    help="Wait at most this long for another deploy of the release; 0 fails at once"
    " [default: as --timeout].",
)


def split_pair(text: str, form: str, **where: Any) -> tuple[str, str]:
    """Return both parts of `NAME=VALUE`.

    Args:
        form: what the error says that it should be.
        where: which option it is, for click.BadParameter.
    """
    name, sign, value = text.partition("=")
    if not name or not sign:
        raise click.BadParameter(f'"{text}" is not {form}', **where)
    return name, value


def read_data(ctx: click.Context, param: click.Parameter, pairs: Sequence[str]) -> dict[str, Any]:
    """Return KEY=VALUE pairs as a mapping."""
    from rigel_k8s.commands.rigelfiles import read_value

    split = (split_pair(pair, "KEY=VALUE", ctx=ctx, param=param) for pair in pairs)
    return {key: read_value(value) for key, value in split}


data_option = click.option(
    "--data",
    metavar="KEY=VALUE",
    multiple=True,
    callback=read_data,
    help="Set {{ data.KEY }}, which a matrix or an earlier job of a sequence would; repeatable.",
)
runnable_argument = click.argument(
    "words",
    nargs=-1,
    required=True,
    metavar="[job|sequence] NAME",
    shell_complete=complete_runnable,
)
job_argument = click.argument("job", required=False, shell_complete=complete_job)
release_argument = click.argument(
    "job", required=False, metavar="[JOB|RELEASE]", shell_complete=complete_release
)
release_option = click.option(
    "--job",
    "--release",
    "job",
    metavar="NAME",
    help="Use the release of this job, or the release with this name.",
    shell_complete=complete_release,
)
namespace_option = click.option(
    "-n",
    "--namespace",
    metavar="NAME",
    expose_value=False,
    callback=choose_namespace,
    help="Use this Kubernetes namespace.",
)
