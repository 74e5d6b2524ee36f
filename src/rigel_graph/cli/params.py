"""`rigel param`: list, get, set."""

from __future__ import annotations

import json
from typing import Any

import click
import yaml

from rigel_k8s.cli.words import (
    Group,
    complete_node,
    json_option,
    namespace_option,
    print_json,
    release_option,
    settings,
)
from rigel_k8s.errors import UserError
from rigel_k8s.yaml_text import write_value


@click.group(cls=Group)
def param() -> None:
    """List, get and set the parameters of a running ROS node.

    NODE is its name in the Rigelfile or in ROS (/driver). In ROS 1 a NAME with a leading / is a
    global parameter.
    """


@param.command("list")
@click.argument("node", shell_complete=complete_node)
@json_option
@release_option
@namespace_option
@click.pass_context
def list_(ctx: click.Context, /, node: str, output: str, job: str | None) -> None:
    """List the parameters of a node, with their values."""
    from rigel_graph.commands import params
    from rigel_k8s.cli.tables import table

    found = params.get_parameters(settings(ctx), node, (), job)
    if output == "json":
        print_json(found.values)
        return
    rows = [[name, write_value(value, flow=True)] for name, value in found.values.items()]
    click.echo(table(["NAME", "VALUE"], rows))


@param.command()
@click.argument("node", shell_complete=complete_node)
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@json_option
@release_option
@namespace_option
@click.pass_context
def get(
    ctx: click.Context, /, node: str, names: tuple[str, ...], output: str, job: str | None
) -> None:
    """Print the values of parameters; of one, the value alone."""
    from rigel_graph.commands import params

    values = params.get_parameters(settings(ctx), node, names, job).values
    if output == "json":
        print_json(values)
    elif len(names) == 1:
        click.echo(write_value(values[names[0]], flow=True))
    else:
        for name in names:
            click.echo(f"{name}: {write_value(values[name], flow=True)}")


@param.command("set", context_settings={"ignore_unknown_options": True})  # -1 is a value
@click.argument("node", shell_complete=complete_node)
@click.argument("words", metavar="NAME VALUE...", nargs=-1, required=True)
@release_option
@namespace_option
@click.pass_context
def set_(ctx: click.Context, /, node: str, words: tuple[str, ...], job: str | None) -> None:
    """Set parameters of a node: all of them, or none if it refuses one.

    VALUE is YAML: 0.5, true, fast, "[1.0, 2.0]". In ROS 2 it lasts until the node starts again; the
    ROS 1 master keeps it.
    """
    from rigel_graph.commands import params

    if len(words) % 2:
        raise UserError(f'the parameter "{words[-1]}" has no value', hint="use NAME VALUE pairs")
    values = {
        name: read_value(name, text) for name, text in zip(words[::2], words[1::2], strict=True)
    }
    found = params.set_parameters(settings(ctx), node, values, job)
    for name, value in found.values.items():
        click.echo(f"{found.node} {name}: {write_value(value, flow=True)}")
    place = f"`parameters` of {found.key}" if found.key else "its `parameters`"
    click.echo(f"{found.effect}; to keep it, write it to {place} in the Rigelfile")


def read_value(name: str, text: str) -> Any:
    """Return a value that is written as YAML.

    Raises:
        UserError: it is not YAML, or no value of a parameter.
    """
    try:
        value = yaml.safe_load(text)
        json.dumps(value)
    except (yaml.YAMLError, TypeError) as error:
        raise UserError(
            f'the value of "{name}" cannot be read: {text}', hint="quote a text: \"'...'\""
        ) from error
    if value is None:
        raise UserError(f'the parameter "{name}" has no value', hint="'\"\"' is an empty text")
    return value
