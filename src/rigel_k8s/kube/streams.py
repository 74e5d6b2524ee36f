"""Answers without an end (watches, logs): each has its own connection, which any thread can end."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress

import urllib3
from urllib3.connection import HTTPConnection

from rigel_k8s.kube.losses import BROKEN

BLOCK = 32 * 1024


class Stream:
    """An endless answer: read its lines, abort it from any thread.

    Attributes:
        aborted: we have ended it.
        ended: the server has ended it, after its last byte.
    """

    def __init__(
        self, connection: HTTPConnection, response: urllib3.BaseHTTPResponse, sock: socket.socket
    ):
        self.connection, self.response, self.socket = connection, response, sock
        self.aborted = self.ended = False

    def lines(self) -> Iterator[bytes]:
        """Yield lines without their end until the server or `abort` ends the stream."""
        rest = b""
        try:
            while block := self.response.read1(BLOCK):
                *whole, rest = (rest + block).split(b"\n")
                for line in whole:
                    if self.aborted:
                        return
                    yield line.rstrip(b"\r")
            self.ended = not self.aborted
            if rest and self.ended:
                yield rest
        except (*BROKEN, ValueError, AttributeError):
            return  # aborted, or the connection broke: the caller decides what was still to come
        finally:
            self.abort()

    def abort(self) -> None:
        """End the stream; a thread that reads it returns."""
        self.aborted = True
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        with suppress(OSError, ValueError, AttributeError):  # a reader may close it at this moment
            self.connection.close()
