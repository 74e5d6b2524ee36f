"""The agent as a program: the broker on one side, the release on the other."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import attrs

from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.errors import UserError
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.kube import connect
from rigel_k8s.settings import Settings
from rigel_muto.agent.address import Login, read_address
from rigel_muto.agent.allowance import Allowance
from rigel_muto.agent.broker import Broker
from rigel_muto.agent.current import Announcer, describe_current
from rigel_muto.agent.memory import Memory
from rigel_muto.agent.options import check_thing
from rigel_muto.agent.protocols.ditto import Ditto as DittoProtocol
from rigel_muto.agent.protocols.ros1 import Ros1
from rigel_muto.agent.protocols.symphony import Symphony
from rigel_muto.agent.serving import Dialect, serve
from rigel_muto.agent.wanted import Record
from rigel_muto.ditto import Access, Ditto
from rigel_muto.execution.executor import ReleaseExecutor
from rigel_muto.execution.target import DeployedJob


@attrs.frozen(kw_only=True)
class Agent:
    """The settings of an agent.

    Attributes:
        thing: the device's id, NAMESPACE:NAME.
        broker: its URL.
        job: the job that commands deploy; None: the only one that deploys.
        credentials: a directory with files that the broker needs.
        target: the device's name in Symphony; None: the thing's NAME.
        twin_url: the Ditto to which the agent reports what runs; None: none.
        health: the port of the probe for the connection to the broker; None: no port.
    """

    thing: str
    broker: str
    job: str | None = None
    credentials: Path | None = None
    prefix: str = "muto"
    target: str | None = None
    twin_url: str | None = None
    access: Access = attrs.field(factory=Access)
    allowance: Allowance = attrs.field(factory=Allowance)
    health: int | None = None

    @property
    def dialects(self) -> tuple[Dialect, ...]:
        """The protocols that it speaks."""
        name = self.thing.partition(":")[2]
        return (
            Ros1(self.thing),
            DittoProtocol(self.thing, self.prefix),
            Symphony(self.target or name, self.prefix),
        )

    @property
    def twin(self) -> Mapping[str, str]:
        """The same as keys of `muto`, for stacks in that Ditto."""
        keys = {"twin_url": self.twin_url, **attrs.asdict(self.access)}
        return {key: value for key, value in keys.items() if value is not None}


def run(agent: Agent, settings: Settings, report: JobReporter) -> None:
    """Accept commands until Ctrl-C or SIGTERM.

    Raises:
        UserError: the Rigelfile, the thing's id, the broker's address or a file is wrong.
        ClusterError: the cluster cannot be reached at the start.
    """
    try:
        check_thing(agent.thing)
    except ValueError as error:
        raise UserError(str(error), hint="an example is org.example.robots:robot-7") from error
    login = read_login(agent.credentials)
    address = read_address(agent.broker)
    application = DeployedJob(settings, report, agent.job, agent.twin)
    dialects = agent.dialects
    topics = [dialect.topic for dialect in dialects]
    announcer = None
    if agent.twin_url:
        ditto = Ditto(agent.twin_url, agent.access, os.environ)
        announcer = Announcer(ditto, agent.thing, report)

    def announce(record: Record) -> None:
        if announcer is not None and record.state != "idle":
            announcer.set(describe_current(record))

    with connect(settings) as cluster, interruptible() as ending:
        release = application.find_release(cluster)
        memory = Memory(cluster, release, create_namespace=application.creates_namespace())
        executor = ReleaseExecutor(application, memory, agent.allowance, announce)
        broker = Broker(address, login, f"rigel-{agent.thing}", topics, report)
        with broker, serve_health(agent.health, lambda: broker.trouble):
            if announcer is not None:
                announcer.start()
            executor.start()
            report.line(f"accepts commands for {agent.thing} from {address}")
            try:
                serve(broker, dialects, executor, report, ending)
            finally:
                executor.close()
        if announcer is not None:
            announcer.close()


def read_login(directory: Path | None) -> Login:
    """Return how to log in to the broker: the files of a directory.

    Raises:
        UserError: the directory does not exist, or its files do not fit together.
    """
    if directory is None:
        return Login()
    if not directory.is_dir():
        raise UserError(
            f"the directory {directory} does not exist",
            hint="create it with username, password, ca.crt, tls.crt and tls.key, or some of them",
        )

    def find(name: str) -> Path | None:
        return directory / name if (directory / name).is_file() else None

    user = find("username")
    return Login(
        user=user.read_text("utf-8").strip() if user else None,
        password_file=find("password"),
        authorities=find("ca.crt"),
        certificate=find("tls.crt"),
        key=find("tls.key"),
    )


class _Handler(BaseHTTPRequestHandler):
    timeout = 10

    def __init__(self, find_trouble: Callable[[], str], *arguments: object) -> None:
        self._find_trouble = find_trouble
        super().__init__(*arguments)  # type: ignore[arg-type]  # what the server passes

    def do_GET(self) -> None:
        trouble = self._find_trouble()
        body = f"{trouble or 'connected to the broker'}\n".encode()
        self.send_response(503 if trouble else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: a line for each probe would hide all others."""


@contextmanager
def serve_health(port: int | None, find_trouble: Callable[[], str]) -> Iterator[None]:
    """Answer 200, or 503 with the trouble, on a port meanwhile; None for no port."""
    if port is None:
        yield
        return
    with ThreadingHTTPServer(("", port), partial(_Handler, find_trouble)) as server:
        thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()
