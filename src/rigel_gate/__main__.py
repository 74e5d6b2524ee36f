"""`python3 -m rigel_gate`: the gate, until SIGTERM.

Two processes: the first one keeps the sockets open and starts the second one, which does the work.
When that is killed, the first starts it again; a caller waits in the socket's queue meanwhile.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import resource
import signal
import socket
import sys
import time
from collections import Counter
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Awaitable, Iterator

from rigel_gate.calls import Answer, Call
from rigel_gate.cluster import ClusterObject, NotKept, Overtaken
from rigel_gate.gate import Gate
from rigel_gate.http import LARGEST_HEAD, Door, HttpLinks
from rigel_gate.memory import Journal, compress, decompress
from rigel_gate.state import Event, State

#: Seconds between two writes to the cluster.
PAUSE = 1.0
#: How often the memory is looked for in the cluster before the gate begins without it.
TRIES = 20
#: Bytes that an object of the cluster may have, with room for the rest of it.
LARGEST = 700_000
#: Where the memory is kept, in words.
FILE, CLUSTER = "the file of the pod", "the cluster"
#: What ends the gate.
SIGNALS = (signal.SIGTERM, signal.SIGINT)
#: Characters of a line of the log.
LINE = 2000
#: Seconds that a worker must live for the next one to start at once.
SHORT = 1.0


def log(text: str) -> None:
    """Print a line, whatever names of nodes are in it."""
    shown = "".join(one if one.isprintable() else repr(one)[1:-1] for one in text[:LINE])
    sys.stdout.write(f"gate: {shown}{'...' if len(text) > LINE else ''}\n")
    sys.stdout.flush()


class Keeper:
    """Keeps the state in the file of the pod at once, and in the cluster within a second."""

    def __init__(self, journal: Journal, place: ClusterObject | None) -> None:
        self._journal = journal
        self._place = place
        self._changed = asyncio.Event()
        self._trouble: dict[str, str] = {}
        self.state = State()

    async def begin(self) -> None:
        """Find what an earlier gate has left: one of this pod, or of another pod."""
        found = None
        try:
            found = self._journal.read()
        except (OSError, ValueError) as error:
            log(f"the memory in {FILE} is not used: {error}")
        if found is None and self._place is not None:
            found = await self._read_cluster(self._place)
        elif found:  # the cluster may not have the last of it
            self._changed.set()
        self.state = found or self.state
        if self.state.left_out:
            log(f"{self.state.left_out} lines of the memory cannot be read: they are left out")
        with self._reporting(FILE):
            self._journal.begin(self.state)

    async def _read_cluster(self, place: ClusterObject) -> State | None:
        """Return what the cluster keeps; asked for a while, since an empty gate forgets nodes."""
        for left in reversed(range(TRIES)):
            try:
                text = await asyncio.get_running_loop().run_in_executor(None, place.read)
                return decompress(text) if text else None
            except NotKept as error:
                log(f"the memory in the cluster cannot be read: {error}")
                await asyncio.sleep(PAUSE if left else 0)
            except ValueError as error:
                log(f"the memory in the cluster is not used: {error}")
                return None
        return None

    def keep(self, event: Event) -> None:
        """Keep an event in the file, and write to the cluster later."""
        with self._reporting(FILE):
            self._journal.keep(event, self.state)
        self._changed.set()

    async def run(self) -> None:
        """Write what has changed to the cluster, until the end."""
        while self._place is not None:
            await self._changed.wait()
            try:
                await self.save()
            except Exception as error:  # without this nothing would be written any more
                self._changed.set()
                self._report(CLUSTER, repr(error))
            await asyncio.sleep(PAUSE)

    async def save(self) -> None:
        """Write the state to the cluster."""
        if self._place is None or not self._changed.is_set():
            return
        self._changed.clear()
        text = compress(self.state)
        try:
            if len(text) > LARGEST:
                raise NotKept(f"it has more than {LARGEST} bytes, compressed")
            await asyncio.get_running_loop().run_in_executor(None, self._place.write, text)
            self._report(CLUSTER, "")
        except Overtaken as error:
            self._report(CLUSTER, str(error))
            self._place = None
        except NotKept as error:
            self._changed.set()
            self._report(CLUSTER, str(error))

    @contextmanager
    def _reporting(self, where: str) -> Iterator[None]:
        """Continue even if a place cannot be written, such as a full disk."""
        try:
            yield
            self._report(where, "")
        except OSError as error:
            self._report(where, str(error))

    def list_troubles(self) -> list[str]:
        """Return where the memory is not kept, and why not."""
        found = self._trouble.items()
        return [f"the memory is not kept in {where}: {why}" for where, why in found if why]

    def _report(self, where: str, trouble: str) -> None:
        if trouble != self._trouble.get(where, ""):
            good = f"the memory is kept in {where} again"
            log(f"the memory is not kept in {where}: {trouble}" if trouble else good)
        self._trouble[where] = trouble


async def serve(sockets: list[socket.socket], options: argparse.Namespace) -> None:
    """Answer until SIGTERM; the last of the sockets is the door of nodes that hand over."""
    place = None
    if options.object:
        place = ClusterObject(options.object, socket.gethostname())
    keeper = Keeper(Journal(options.journal), place)
    await keeper.begin()
    links = HttpLinks(options.master_port)
    own = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or socket.gethostname()
    uri = f"http://{own}:{options.port}/"
    gate = Gate(keeper.state, links, uri, keeper.keep, log, keeper.list_troubles)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in SIGNALS:
        loop.add_signal_handler(number, ended.set)
    loop.set_exception_handler(FailureLog())
    gate.start()
    callers: Counter[str] = Counter()

    def answering(call: Call, host: str, *, hands_over: bool) -> Awaitable[Answer]:
        return gate.answer(call, hands_over=hands_over, host=host)

    for door, hands_over in zip(sockets, (False, True)):
        answer = partial(answering, hands_over=hands_over)
        await asyncio.start_server(Door(answer, callers).serve, sock=door, limit=LARGEST_HEAD)
    saving = asyncio.ensure_future(keeper.run())
    await ended.wait()
    saving.cancel()
    await keeper.save()
    await gate.stop()


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
    """Return a listening socket."""
    door = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    door.bind(("0.0.0.0", port))
    door.listen(1024)
    return door


def supervise(sockets: list[socket.socket], options: argparse.Namespace) -> int:
    """Start workers until SIGTERM; return the exit code."""
    ended: list[int] = []
    worker = 0

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
        worker = os.fork()
        if worker == 0:
            work(sockets, options)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        status = os.waitpid(worker, 0)[1]
        worker = 0
        if not ended:
            log(f"started again (the worker ended with status {status})")
            if time.monotonic() - started < SHORT:
                time.sleep(SHORT / 2)


def work(sockets: list[socket.socket], options: argparse.Namespace) -> None:
    """Serve in a worker; a signal that came earlier ends it. Never returns."""
    code = 1
    try:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        asyncio.run(serve(sockets, options))
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
