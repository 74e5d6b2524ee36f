"""The entry: global options, the table of commands, errors and exit codes.

Commands are imported when they are called: `rigel --help` costs little more than click itself.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import click

from rigel_k8s import __version__, signals
from rigel_k8s.cli.colors import choose_color
from rigel_k8s.cli.width import find_width, wrap
from rigel_k8s.errors import RigelK8sError

INTERRUPTED = 130

#: Command -> (module of this package, one line of help), in the order of the help.
COMMANDS = {
    "init": ("rigelfiles", "Write a commented Rigelfile to start from."),
    "check": ("rigelfiles", "Report all problems of the Rigelfile at once."),
    "explain": ("explain", "Explain a state of a pod, such as CrashLoopBackOff."),
    "schema": ("rigelfiles", "Print a JSON schema of Rigelfiles, for editors."),
    "trust": ("trusting", "Trust the Python code beside a Rigelfile; list, remove."),
    "run": ("runs", "Run a job or a sequence."),
    "render": ("releases", "Print the manifests that a job would apply."),
    "diff": ("releases", "Show what a job would change on the cluster."),
    "list": ("listing", "List the releases of a namespace or of the cluster."),
    "status": ("releases", "Show what runs where, and why something is not ready."),
    "graph": ("rosgraph", "Show the ROS graph: nodes by machine, topics, what is wrong."),
    "logs": ("pods", "Print the logs of ROS nodes."),
    "ui": ("ui", "Show a release live in the browser."),
    "top": ("top", "Show CPU, memory and traffic of ROS nodes, and topics."),
    "exec": ("pods", "Run a command in a ROS node's container, with ROS set up."),
    "forward": ("pods", "Forward local ports to a ROS node."),
    "history": ("releases", "List the revisions of a release."),
    "rollback": ("releases", "Go back to an earlier revision."),
    "down": ("releases", "Delete a release; its volumes stay unless --volumes."),
    "doctor": ("doctors", "Check what a deploy needs: cluster, rights, nodes."),
    "rbac": ("rbac", "Print the least rights for deploying, viewing or installing."),
    "observe": ("observe", "Open Grafana, Prometheus and Loki here; status, remove."),
    "muto": ("rigel_muto.cli", "Use stacks of Eclipse Muto, and take its commands."),
    "network": ("network", "Second networks for pods: install, status, remove Multus."),
    "cluster": ("cluster", "A real Kubernetes on this machine: up, down, status, load."),
    "image": ("images", "Images for machines that cannot pull from the internet."),
    "completion": ("completions", "Print the shell completion for bash, zsh or fish."),
    "version": ("completions", "Print the version."),
}


class Commands(click.Group):
    """A group whose commands' modules are imported when a command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all names, in the table's order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command, None if the name is unknown."""
        if cmd_name not in COMMANDS:
            return None
        name = COMMANDS[cmd_name][0]
        module = import_module(name if "." in name else f"rigel_k8s.cli.{name}")
        known = vars(module)  # `exec` and `list` are Python's own names
        command: click.Command = known.get(cmd_name) or known[f"{cmd_name}_"]
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or suggest a similar one."""
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            from difflib import get_close_matches

            close = get_close_matches(args[0], COMMANDS, n=1)
            meant = f' Did you mean "{close[0]}"?' if close else ""
            raise click.UsageError(f'Unknown command "{args[0]}".{meant}', ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Options come before the command: rigel -f robots/Rigelfile -n lab logs -f talker",
)
@click.option(
    "-f",
    "--file",
    "rigelfile",
    type=click.Path(path_type=Path),
    default=Path("Rigelfile"),
    show_default=True,
    help="Read this Rigelfile.",
)
@click.option(
    "--context", metavar="NAME", help="Use this kubeconfig context [default: the current one]."
)
@click.option(
    "--kubeconfig",
    type=click.Path(path_type=Path),
    help="Use this kubeconfig [default: $KUBECONFIG].",
)
@click.option("-n", "--namespace", metavar="NAME", help="Use this Kubernetes namespace.")
@click.option(
    "--trust", is_flag=True, help="Trust the Rigelfile's directory, as `rigel trust` does."
)
@click.option("-q", "--quiet", is_flag=True, help="Print only warnings and results.")
@click.option(
    "-v",
    "--verbose",
    is_flag=True,
    help="Print every change as a line, and errors with their traceback.",
)
@click.option(
    "--no-color", is_flag=True, help="Print no colors and no live rows (as with $NO_COLOR)."
)
@click.version_option(__version__, prog_name="rigel-k8s")
@click.pass_context
def cli(ctx: click.Context, /, **options: Any) -> None:
    """ROS applications on Kubernetes from one Rigelfile."""
    ctx.obj = {} if ctx.obj is None else ctx.obj
    ctx.obj.update(options)
    ctx.color = choose_color(no_color=options["no_color"])
    if options["trust"]:
        from rigel_k8s.system.trust import trust

        trust(options["rigelfile"].parent)


def main(arguments: Sequence[str] | None = None, *, name: str | None = None) -> None:
    """Run the command line and end the process.

    Exit codes: 0, 1 something went wrong, 2 what the user wrote is wrong, 130 interrupted by
    Ctrl-C, 143 by SIGTERM; `exec` passes on its command's, `diff --exit-code` returns 1 if there
    are differences.

    Args:
        name: the program's name if it was called by another one; then Rigel is never run.
    """
    # A thousand nodes are a million values, and all of them are kept: searching them for garbage
    # again and again would take as long as the work, and longer the more nodes there are.
    gc.set_threshold(100_000, 50, 50)
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None and name is None and words[:1] in (["init"], ["run"]):
        from rigel_k8s.compat import handover

        entry = handover(sys.argv)
        if entry is not None:
            sys.exit(entry())
    code = run(words, name)
    if code == INTERRUPTED:
        code = signals.exit_code()
        # Cancelled threads that have not ended would block the terminal until they do.
        sys.stderr.flush()
        os._exit(code)
    if arguments is None:
        leave(code)
    sys.exit(code)


def leave(code: int) -> NoReturn:
    """End the process without freeing memory, a tenth of the time of a short command."""
    import atexit

    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # closed by its reader
            stream.flush()
    os._exit(code)


def run(words: list[str], name: str | None) -> int:
    """Run the words and return the exit code."""
    options: dict[str, Any] = {}
    try:
        result = cli.main(
            args=words, prog_name=name or program(), standalone_mode=False, obj=options
        )
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except RigelK8sError as error:
        color = choose_color(no_color=bool(options.get("no_color")))
        show(error, causes=bool(options.get("verbose")), color=color)
        return error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        # The cursor is behind a ^C, or behind the question that Ctrl-D has ended.
        signals.forget_echo()
        click.echo("\ninterrupted" if sys.stderr.isatty() else "interrupted", err=True)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has ended (`| head`): this is not an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception:
        return report_bug()


def program() -> str:
    """Return the name under which the user called us."""
    return Path(sys.argv[0]).name if sys.argv and sys.argv[0] else "rigel"


def report_bug() -> int:
    """Print the traceback of a bug, and ask to report it."""
    from traceback import format_exc

    click.echo(format_exc(), err=True, nl=False)
    click.echo(
        f"This is a bug in rigel-k8s {__version__}: please report it, with the lines above and the"
        " command that you ran.",
        err=True,
    )
    return 1


def show(error: RigelK8sError, *, causes: bool = False, color: bool | None = None) -> None:
    """Print an error: what went wrong, its details, what to do next."""
    signals.begin_line()
    if causes:
        from traceback import format_exc

        click.echo(format_exc(), err=True, nl=False)
    click.secho("error: ", fg="red", bold=True, nl=False, err=True, color=color)
    click.echo(wrap(error.message, sys.stderr, len("error: ")), err=True)
    margin = "  "
    for detail in error.fit_details(find_width(sys.stderr) - len(margin)):
        for line in detail.splitlines():
            click.echo(f"{margin}{line}", err=True)
    if error.hint:
        click.secho("hint: ", fg="cyan", bold=True, nl=False, err=True, color=color)
        click.echo(error.hint, err=True)
