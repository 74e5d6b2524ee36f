"""What several commands' words share: the settings, durations, JSON on standard output."""

from __future__ import annotations

import json
from typing import Any

import click

from rigel_k8s.settings import Settings

__all__ = ["Timeout", "colored", "json_option", "print_json", "quiet", "settings"]


def settings(ctx: click.Context, *, timeout: float | None = None, adopt: bool = False) -> Settings:
    """Return the global options as Settings."""
    words = ctx.find_root().obj
    return Settings(
        rigelfile=words["rigelfile"],
        context=words["context"],
        kubeconfig=words["kubeconfig"],
        namespace=words["namespace"],
        timeout=timeout,
        adopt=adopt,
    )


def quiet(ctx: click.Context) -> bool:
    """Return whether -q was given."""
    return bool(ctx.find_root().obj["quiet"])


def colored(ctx: click.Context) -> bool | None:
    """Return False where colour was refused, None where the terminal decides."""
    return ctx.find_root().color


class Timeout(click.ParamType[float]):
    """A duration such as 90, 90s, 5m or 1h, as seconds."""

    name = "duration"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return seconds."""
        if isinstance(value, int | float):
            return float(value)
        units = {"s": 1.0, "m": 60.0, "h": 3600.0}
        number, unit = (value[:-1], value[-1]) if value[-1:] in units else (value, "s")
        try:
            seconds = float(number) * units[unit]
        except ValueError:
            seconds = -1.0
        if not 0 < seconds < 1e9:
            self.fail(f'"{value}" is no duration: write 90s, 5m or 1h', param, ctx)
        return seconds


json_option = click.option(
    "-o", "--output", type=click.Choice(["table", "json"]), default="table", help="The form."
)


def print_json(data: Any) -> None:
    """Print data for a script."""
    click.echo(json.dumps(data, indent=2, default=str))
