"""Our job types and providers as plugins and providers of Rigel 0.3.

A plugin's setup checks, start works, stop never tears down. Rigel calls stop() after success too,
and from its signal handler, in the middle of start(); so the work runs in a separate thread, and
stop() cancels it and waits for it, once. Reports of jobs go to Rigel's log, errors become its own.
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar

from rigel_k8s.compat.found import command_line, find_use
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.jobs.engine import GRACE
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.names import Builtin, Kind, index_by_name, list_installed
from rigel_k8s.jobs.registry import job_type, provider_type
from rigel_k8s.jobs.runner import Prepared, prepare_use, run
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.rigelfile import load, realise
from rigel_k8s.settings import Settings

BASES: Mapping[Kind, tuple[str, str]] = {
    "job": ("rigel.plugins.plugin", "Plugin"),
    "provider": ("rigel.providers.provider", "Provider"),
}
#: The logger that Rigel configures with a handler and colours.
LOGGER = logging.getLogger("Rigel")


def public(name: str) -> Any:
    """Return what `rigel_k8s.NAME` is: `OrchestrationPlugin`, `ContainerRegistryProvider` ...

    A subclass of Rigel's Plugin if Rigel has been imported already (it loads nothing else), and
    otherwise the job type.

    Raises:
        AttributeError: the name does not exist.
    """
    path = f"rigel_k8s.{name}"
    for kind, (module, attribute) in BASES.items():
        installed = (one for one in list_installed(kind) if path in one.paths)
        builtin = index_by_name(kind).get(path) or next(installed, None)
        if builtin:
            base = getattr(sys.modules.get(module), attribute, None)
            return _adapt(kind, name, builtin, base) if base else builtin.load()
    raise AttributeError(f"module 'rigel_k8s' has no attribute {name!r}")


@cache
def _adapt(kind: Kind, name: str, builtin: Builtin, base: type[Any]) -> type[Any]:
    adapter = JobPlugin if kind == "job" else ConnectionProvider
    members = {"builtin": builtin, "__module__": "rigel_k8s", "__doc__": adapter.__doc__}
    return type(name, (adapter, base), members)


class LogReport:
    """A reporter that writes a line for each change into Rigel's log."""

    def __init__(self, name: str = "") -> None:
        self._prefix = f"{name}: " if name else ""
        self._states: dict[str, str] = {}

    def line(self, text: str) -> None:
        """Log something."""
        LOGGER.info("%s%s", self._prefix, text)

    def warn(self, text: str) -> None:
        """Log something that the user should look at."""
        LOGGER.warning("%s%s", self._prefix, text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Log a state once."""
        if state and self._states.get(key) != state:
            self._states[key] = state
            LOGGER.info("%s%s: %s", self._prefix, key, state)

    def child(self, name: str) -> JobReporter:
        """Return a reporter whose lines begin with the name too."""
        return LogReport(f"{self._prefix}{name}")


def rigel_error(error: RigelK8sError) -> Exception:
    """Return Rigel's error with the text of ours; Rigel logs it and exits with 1."""
    lines = [error.message, *(f"  {detail}" for detail in error.details)]
    if error.hint:
        lines.append(f"hint: {error.hint}")
    cls: type[Exception] = getattr(sys.modules.get("rigel.exceptions"), "RigelError", RuntimeError)
    return cls("\n".join(lines))


class JobPlugin:
    """A job type of rigel-k8s as a plugin of Rigel.

    The Rigelfile is read again with the rules of rigel-k8s; see docs/rigel.md.
    """

    builtin: ClassVar[Builtin]

    def __init__(
        self,
        raw_data: dict[str, Any],
        global_data: Any,
        application: Any,
        providers_data: dict[str, Any],
        shared_data: dict[str, Any] | None = None,
    ) -> None:
        self._data = {} if shared_data is None else shared_data
        self._providers = providers_data
        self._scope = CancelScope()
        self._prepared: Prepared | None = None
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None
        # Rigel's Plugin follows this class in the bases; it renders the data of earlier jobs.
        super().__init__(raw_data, global_data, application, providers_data, self._data)  # type: ignore[call-arg]

    def setup(self) -> None:
        """Find the job in the Rigelfile and check it.

        Raises:
            RigelError: what is wrong with it, with lines and columns.
        """
        try:
            self._prepared = self._prepare()
            for warning in self._prepared.warnings:
                LogReport().warn(warning)
        except RigelK8sError as error:
            raise rigel_error(error) from error

    def start(self) -> None:
        """Do the job's work, to its end.

        Raises:
            RigelError: it failed.
        """
        assert self._prepared, "Rigel calls setup() before start()"
        self._thread = threading.Thread(target=self._work, args=(self._prepared,), daemon=True)
        self._thread.start()
        self._thread.join()
        if isinstance(self._error, RigelK8sError):
            raise rigel_error(self._error) from self._error
        if self._error:
            raise self._error

    def process(self) -> None:
        """Do nothing: Rigel skips this for dependencies, so start() does all the work."""

    def stop(self) -> None:
        """Cancel work that still runs, and wait for it; what was deployed stays."""
        again = self._scope.cancelled.is_set()
        self._scope.cancel()
        if self._thread and not again:
            self._thread.join(GRACE)

    def _prepare(self) -> Prepared:
        line = command_line()
        rigelfile = load(line.file)
        options = job_type(self.builtin.short).options
        given: dict[str, Any] = self.raw_data  # type: ignore[attr-defined]
        use = find_use(rigelfile, self.builtin, options, given, self._data, line)
        return prepare_use(rigelfile, use, Settings(rigelfile=line.file))

    def _work(self, prepared: Prepared) -> None:
        try:
            run(
                prepared,
                LogReport(),
                data=self._data,
                connected=self._providers,
                scope=self._scope,
            )
        except BaseException as error:
            self._error = error


class ConnectionProvider:
    """A provider of rigel-k8s as a provider of Rigel; plugins find its connection by its name."""

    builtin: ClassVar[Builtin]
    identifier: str
    providers_data: dict[str, Any]

    def connect(self) -> None:
        """Connect with the options of the Rigelfile.

        Raises:
            RigelError: they are wrong, or it could not connect.
        """
        self._kind = provider_type(self.builtin.short)
        try:
            rigelfile = load(command_line().file)
            spec = rigelfile.providers[self.identifier]
            options = realise(rigelfile, spec, None, {}, self._kind.options).options
            connection = self._kind.connect(options, self.identifier, LogReport())
        except RigelK8sError as error:
            raise rigel_error(error) from error
        self.providers_data[self.identifier] = connection

    def disconnect(self) -> None:
        """Undo connect."""
        if self.identifier in self.providers_data:
            self._kind.disconnect(self.providers_data.pop(self.identifier))
