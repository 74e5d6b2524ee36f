"""`python3 -m rigel_gate`: the gate, until SIGTERM.

Two processes: the first one keeps the sockets open and starts the second one, which does the work.
When that is killed, the first starts it again; a caller waits in the socket's queue meanwhile.
"""

from __future__ import annotations

import argparse
import asyncio
import mmap
import os
import resource
import signal
import socket
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Awaitable

from rigel_gate.calls import Answer, Call
from rigel_gate.cluster import ClusterObject
from rigel_gate.gate import Gate
from rigel_gate.http import LARGEST_HEAD, Callers, Door, HttpLinks
from rigel_gate.keeper import Keeper
from rigel_gate.memory import Journal

#: What ends the gate.
SIGNALS = (signal.SIGTERM, signal.SIGINT)
#: Characters of a line of the log.
LINE = 2000
#: Seconds after which a thread that reads a large call lets others be answered.
SWITCH = 0.001
#: Seconds that a worker must live for the next one to start at once.
SHORT = 1.0
#: Seconds after which a worker without a master has started.
STARTS = 30.0


def log(text: str) -> None:
    """Print a line, whatever names of nodes are in it."""
    shown = "".join(one if one.isprintable() else repr(one)[1:-1] for one in text[:LINE])
    sys.stdout.write(f"gate: {shown}{'...' if len(text) > LINE else ''}\n")
    sys.stdout.flush()


async def serve(sockets: list[socket.socket], options: argparse.Namespace, start: Start) -> None:
    """Answer until SIGTERM; the last of the sockets is the door of nodes that hand over."""
    place = None
    if options.object:
        place = ClusterObject(options.object, socket.gethostname())
    keeper = Keeper(Journal(options.journal), place, log)
    start.use_file()
    await keeper.begin(start.failures)
    links = HttpLinks(options.master_port)
    own = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or socket.gethostname()
    uri = f"http://{own}:{options.port}/"
    loop = asyncio.get_running_loop()
    callers = Callers(log, loop)

    def list_notes() -> list[str]:
        return keeper.notes + callers.list_notes()

    gate = Gate(keeper.state, links, uri, keeper.keep, log, keeper.list_troubles, list_notes)
    ended = asyncio.Event()
    for number in SIGNALS:
        loop.add_signal_handler(number, ended.set)
    loop.set_exception_handler(FailureLog())
    gate.start()

    def answering(call: Call, host: str, *, hands_over: bool) -> Awaitable[Answer]:
        return gate.answer(call, hands_over=hands_over, host=host)

    for door, hands_over in zip(sockets, (False, True)):
        answer = partial(answering, hands_over=hands_over)
        await asyncio.start_server(Door(answer, callers).serve, sock=door, limit=LARGEST_HEAD)
    saving = asyncio.ensure_future(keeper.run())
    starting = asyncio.ensure_future(start.finish(gate))
    await ended.wait()
    saving.cancel()
    starting.cancel()
    await keeper.save()
    await gate.stop()


class Start:
    """How far a worker has come, which its parent process sees, too.

    Attributes:
        failures: how many workers before it have ended in their start, one after the other. One
            that was killed before it used the file does not count.
    """

    def __init__(self) -> None:
        self.failures = 0
        self._phase = mmap.mmap(-1, 1)  # one byte that both processes share

    def begin(self) -> None:
        """Note that a worker is about to start."""
        self._phase[0] = 0

    def use_file(self) -> None:
        self._phase[0] = 1

    async def finish(self, gate: Gate) -> None:
        """Note that a worker has started: a master is complete, or there is none for a while."""
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(gate.until_ready(), STARTS)
        self._phase[0] = 2

    def end(self) -> None:
        """Note that a worker has ended."""
        if self._phase[0]:
            self.failures = self.failures + 1 if self._phase[0] == 1 else 0


class FailureLog:
    """Logs what asyncio reports in one line, and the same again once a minute at most.

    Without free files it reports each connection that it cannot take.
    """

    def __init__(self) -> None:
        self._last, self._when = "", 0.0

    def __call__(self, _: asyncio.AbstractEventLoop, failure: dict[str, Any]) -> None:
        """Take a failure, as the handler of a loop's exceptions."""
        text = f"{failure['message']}: {failure.get('exception')}"
        if text != self._last or time.monotonic() - self._when > 60:
            self._last, self._when = text, time.monotonic()
            log(f"error: {text}")


def listen(port: int) -> socket.socket:
    door = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    door.bind(("0.0.0.0", port))
    door.listen(1024)
    return door


def supervise(sockets: list[socket.socket], options: argparse.Namespace) -> int:
    """Start workers until SIGTERM; return the exit code."""
    ended: list[int] = []
    worker, start = 0, Start()

    def end(number: int, _: object) -> None:
        ended.append(number)
        if worker:
            with suppress(ProcessLookupError):
                os.kill(worker, signal.SIGTERM)

    for number in SIGNALS:
        signal.signal(number, end)
    while True:
        # Python forgets a signal that comes while it forks.
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        if ended:
            return 0
        started = time.monotonic()
        start.begin()
        worker = os.fork()
        if worker == 0:
            work(sockets, options, start)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        status = os.waitpid(worker, 0)[1]
        worker = 0
        start.end()
        if not ended:
            log(f"started again (the worker ended with status {status})")
            if time.monotonic() - started < SHORT:
                time.sleep(SHORT / 2)


def work(sockets: list[socket.socket], options: argparse.Namespace, start: Start) -> None:
    """Serve in a worker; a signal that came earlier ends it. Never returns."""
    code = 1
    try:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        sys.setswitchinterval(SWITCH)
        asyncio.run(serve(sockets, options, start))
        code = 0
    except Exception as error:
        log(f"failed: {error!r}")
    finally:
        sys.stdout.flush()
        os._exit(code)


def main(arguments: list[str]) -> int:
    """Open the sockets and serve; return the exit code, 1 if a port is taken."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a file for each connection
    parser = argparse.ArgumentParser(prog="gate")
    parser.add_argument("--port", type=int, default=11311, help="where nodes find the master")
    parser.add_argument(
        "--hand-over-port", type=int, default=11310, help="for nodes that hand their names over"
    )
    parser.add_argument("--master-port", type=int, default=11312, help="roscore's own")
    parser.add_argument(
        "--journal", type=Path, required=True, help="a file that only the gate uses"
    )
    parser.add_argument("--object", default="", help="the Secret that keeps the memory")
    options = parser.parse_args(arguments)
    try:
        sockets = [listen(options.port), listen(options.hand_over_port)]
    except OSError as error:
        log(f"a port is taken: {error.strerror}")
        return 1
    return supervise(sockets, options)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
