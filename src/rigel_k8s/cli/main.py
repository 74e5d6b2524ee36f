"""The entry: global options, the table of commands, errors and exit codes.

Commands are imported when they are called: `rigel --help` costs little more than click itself.
"""

from __future__ import annotations

import errno
import gc
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from rigel_k8s import __version__, signals
from rigel_k8s.cli.width import choose_color, find_width, wrap
from rigel_k8s.errors import ClusterError, RigelK8sError, UserError

if TYPE_CHECKING:
    from rigel_k8s.installed import Group

INTERRUPTED = 130
#: What a write to standard output fails with where nothing more fits: a full disk, a quota.
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}

#: Command -> (module, one line of help), in the order of the help.
COMMANDS = {
    "init": ("rigelfiles", "Write a commented Rigelfile to start from."),
    "check": ("rigelfiles", "Report all problems of the Rigelfile at once."),
    "explain": ("explain", "Explain a state of a pod, such as CrashLoopBackOff."),
    "schema": ("rigelfiles", "Print a JSON schema of Rigelfiles, for editors."),
    "trust": ("trusting", "Trust the Python code beside a Rigelfile; list, remove."),
    "run": ("runs", "Run a job or a sequence."),
    "test": ("testing", "Deploy a job or a sequence, run its tests, and delete it."),
    "render": ("releases", "Print the manifests that a job would apply."),
    "diff": ("releases", "Show what a job would change on the cluster."),
    "list": ("listing", "List the releases of a namespace or of the cluster."),
    "status": ("status", "Show what runs where, and why something is not ready."),
    "logs": ("pods", "Print the logs of ROS nodes."),
    "top": ("top", "Show CPU, memory and traffic of ROS nodes, and topics."),
    "exec": ("pods", "Run a command in a ROS node's container, with ROS set up."),
    "join": ("join", "Run a program of this computer in the network of a release."),
    "dev": ("dev", "Run a ROS node with the files of this computer, as they change."),
    "bags": ("bags", "Bags that a release has recorded: list, fetch, delete."),
    "forward": ("pods", "Forward local ports to a ROS node."),
    "restart": ("releases", "Replace the pods of ROS nodes, as in an update."),
    "history": ("releases", "List the revisions of a release."),
    "rollback": ("releases", "Go back to an earlier revision."),
    "down": ("releases", "Delete a release; its volumes stay unless --volumes."),
    "doctor": ("doctors", "Check what a deploy needs: cluster, rights, nodes."),
    "rbac": ("rbac", "Print the least rights for deploying, viewing or installing."),
    "completion": ("completions", "Print the shell completion for bash, zsh or fish."),
    "version": ("completions", "Print the version."),
}


def list_all_commands() -> dict[str, tuple[str, str]]:
    """Return the table with the rows that other packages add, each after the one that it names."""
    from rigel_k8s.installed import find, list_names

    group: Group = "rigel_k8s.commands"
    added = {name: find(group, name) for name in sorted(list_names(group) - COMMANDS.keys())}
    rows = list(COMMANDS.items())
    while added:  # one that follows another added one comes after that
        name = next((name for name in added if added[name][-1] not in added), next(iter(added)))
        module, text, *follows = added.pop(name)
        before = [number for number, row in enumerate(rows, 1) if row[0] in follows]
        rows.insert(before[0] if before else len(rows), (name, (module, text)))
    return dict(rows)


def find_row(name: str) -> Sequence[str] | None:
    """Return a command's row, None if no package adds it; the others' rows are not loaded."""
    if name in COMMANDS:
        return COMMANDS[name]
    from rigel_k8s.installed import find

    row: Sequence[str] | None = find("rigel_k8s.commands", name)
    return row


#: What other tools call a command.
OTHER_WORDS = {
    **dict.fromkeys(("apply", "deploy", "install", "start", "up", "upgrade"), "run"),
    **dict.fromkeys(("describe", "get", "ps"), "status"),
    **dict.fromkeys(("delete", "destroy", "remove", "rm", "stop", "uninstall"), "down"),
    **dict.fromkeys(("node", "nodes", "rosnode"), "graph"),
    **dict.fromkeys(("echo", "rostopic", "topics"), "topic"),
    **dict.fromkeys(("params", "rosparam"), "param"),
    **dict.fromkeys(("lint", "validate"), "check"),
    **dict.fromkeys(("attach", "shell", "ssh"), "exec"),
    **{"ls": "list", "plan": "diff", "port-forward": "forward", "template": "render"},
    **{"hz": "topic hz", "stats": "top", "undo": "rollback", "web": "ui"},
}


class Commands(click.Group):
    """A group whose commands' modules are imported when a command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(list_all_commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command, None if the name is unknown."""
        row = find_row(cmd_name)
        if row is None:
            return None
        name = row[0]
        module = import_module(name if "." in name else f"rigel_k8s.cli.{name}")
        known = vars(module)  # `exec` and `list` are Python's own names
        command: click.Command = known.get(cmd_name) or known[f"{cmd_name}_"]
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, or suggest a similar one."""
        if args and not args[0].startswith("-") and find_row(args[0]) is None:
            from difflib import get_close_matches

            other = OTHER_WORDS.get(args[0])
            close = [other] if other else get_close_matches(args[0], self.list_commands(ctx), n=1)
            meant = f', did you mean "{close[0]}"?' if close else ""
            raise click.UsageError(f'unknown command "{args[0]}"{meant}', ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table without importing any command."""
        with formatter.section("Commands"):
            rows = list_all_commands().items()
            formatter.write_dl([(name, text) for name, (_, text) in rows])


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
    if not open_streams():
        click.echo("error: standard output is closed; to discard it, use > /dev/null", err=True)
        sys.exit(1)
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


def open_streams() -> bool:
    """Open standard error if it is closed, and return whether standard output is open.

    A connection or a file would otherwise get its number, and what is written to it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w")
    return sys.stdout is not None


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
        message = error.format_message().rstrip(".")
        path = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else ""
        show(
            UserError(
                message[:1].lower() + message[1:],
                hint=f"`{path} --help` shows how it is used" if path else None,
            ),
            color=choose_color(no_color=bool(options.get("no_color"))),
        )
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
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:
            return report_bug()
        show(ClusterError(f"cannot write the output: {error.strerror}"))
        return 1
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
        message, *snippet = detail.splitlines() or [""]
        click.echo(f"{margin}{wrap(message, sys.stderr, len(margin), margin)}", err=True)
        for line in snippet:
            click.echo(f"{margin}{line}", err=True)
    if error.hint:
        click.secho("hint: ", fg="cyan", bold=True, nl=False, err=True, color=color)
        click.echo(wrap(error.hint, sys.stderr, len("hint: ")), err=True)
