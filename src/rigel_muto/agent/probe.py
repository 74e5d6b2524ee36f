"""`python3 -m rigel_muto.agent.probe PORT`: what keeps the agent from its broker.

Why: Kubernetes shows what a probe prints, but of one over HTTP only the number of the status. So
`rigel status` can report why an agent is not ready. It imports next to nothing, since it runs every
few seconds; health.py answers it.
"""

from __future__ import annotations

import socket
import sys

PATIENCE = 5.0
MOST_BYTES = 4096


def main(words: list[str]) -> int:
    """Print what the agent answers; return the exit code, 0 if it is well."""
    try:
        answer = ask(int(words[0]))
    except OSError as error:
        print(f"the agent does not answer at port {words[0]}: {error}")  # noqa: T201 - its output
        return 1
    head, _, body = answer.partition("\r\n\r\n")
    print(body.strip())  # noqa: T201
    return 0 if head.split()[1:2] == ["200"] else 1


def ask(port: int) -> str:
    """Return an agent's whole answer."""
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
        connection.sendall(b"GET /healthz HTTP/1.0\r\n\r\n")
        found = b""
        while len(found) < MOST_BYTES and (part := connection.recv(MOST_BYTES)):
            found += part
    return found.decode("utf-8", "replace")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
