"""Classes written for Rigel 0.3 (setup, start, process, stop), run as jobs and providers of ours.

They are recognised by their shape: Rigel itself is needed only if the class imports it.
"""

from __future__ import annotations

import copy
import inspect
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

import attrs

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.jobs.job import JobContext, JobReporter
from rigel_k8s.jobs.names import Kind
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application

METHODS = {"job": ("setup", "start", "process", "stop"), "provider": ("connect", "disconnect")}
#: raw_data, global_data, application, providers_data, shared_data; identifier and three of those
ARGUMENTS = {"job": 5, "provider": 4}


def fits(cls: type[Any], kind: Kind) -> bool:
    """Return whether the class has the methods and the constructor that Rigel calls."""
    if not all(callable(getattr(cls, method, None)) for method in METHODS[kind]):
        return False
    try:
        inspect.signature(cls).bind(*[None] * ARGUMENTS[kind])
    except (TypeError, ValueError):
        return False
    return True


@attrs.frozen
class RigelApplication:
    """What such classes read of Rigel's own application model."""

    distro: str
    dir: str


class _Adapter:
    """What an adapter of a job has in common with that of a provider."""

    options: ClassVar[type[Any]] = dict

    def __init__(self, cls: type[Any]) -> None:
        self._cls = cls

    def check(self, options: dict[str, Any], application: Application) -> Sequence[Problem]:
        """Return nothing: such a class checks its data only when it is constructed."""
        return ()


class RigelStyleJob(_Adapter):
    """A job type around a plugin class of Rigel's; stop() is called however the job ends, once."""

    def run(self, options: dict[str, Any], job: JobContext) -> None:
        """Set up, start, process (or serve others until cancelled), stop."""
        with _translate_errors():
            plugin = self._cls(
                copy.deepcopy(options),
                copy.deepcopy(dict(job.vars)),
                RigelApplication(job.application.distro, str(job.application.dir)),
                dict(job.providers),
                job.data,
            )
            with _stop_once(plugin, job.cancel):
                _phases(plugin, job)
        if job.cancel.is_set() and not job.serving:
            raise Interrupted(f"job {job.name} was stopped")


def _phases(plugin: Any, job: JobContext) -> None:
    for phase in (plugin.setup, plugin.start):
        if job.cancel.is_set():
            return
        phase()
    if job.serving:
        job.ready.set()
        job.cancel.wait()
    elif not job.cancel.is_set():
        plugin.process()


@contextmanager
def _stop_once(plugin: Any, cancel: threading.Event) -> Iterator[None]:
    """Call stop() at the end, or at once from another thread when the job is cancelled.

    Rigel calls it from a signal handler, while another method runs; plugins are written for that.
    """
    claim = threading.Lock()
    failures: list[BaseException] = []

    def stop() -> None:
        if claim.acquire(blocking=False):
            try:
                plugin.stop()
            except BaseException as error:
                failures.append(error)

    def watch() -> None:
        cancel.wait()
        stop()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        stop()
        if cancel.is_set():
            watcher.join()
    if failures:
        raise failures[0]


class RigelStyleProvider(_Adapter):
    """A provider around a provider class of Rigel's; jobs get what it stores under its name."""

    def __init__(self, cls: type[Any]) -> None:
        super().__init__(cls)
        self._connected: list[tuple[Any, Any]] = []

    def connect(self, options: dict[str, Any], name: str, report: JobReporter) -> Any:
        """Connect; the connection is what the class stored for others, or else its instance."""
        data: dict[str, Any] = {}
        with _translate_errors():
            provider = self._cls(name, copy.deepcopy(options), {}, data)
            provider.connect()
        connection = data.get(name, provider)
        self._connected.append((connection, provider))
        return connection

    def disconnect(self, connection: Any) -> None:
        """Disconnect the instance that the connection came from."""
        for index, (known, provider) in enumerate(self._connected):
            if known is connection:
                del self._connected[index]
                with _translate_errors():
                    provider.disconnect()
                return


@contextmanager
def _translate_errors() -> Iterator[None]:
    """Turn Rigel's own errors, and exit(), into our errors; others are bugs and stay."""
    try:
        yield
    except SystemExit as error:
        raise RigelK8sError(f"it called exit({error.code})") from error
    except Exception as error:
        if isinstance(error, _rigel_error()):
            raise RigelK8sError(str(error)) from error
        raise


def _rigel_error() -> tuple[type[BaseException], ...]:
    """Return Rigel's base error if Rigel has been imported (by the class that runs)."""
    error = getattr(sys.modules.get("rigel.exceptions"), "RigelError", None)
    return (error,) if error else ()
