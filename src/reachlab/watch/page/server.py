"""The page over HTTP: its parts as soon as they are known, and an arm that Python moves for it.

A page asks for what it needs by a POST and is answered by the newest moment, so that nothing gathers up for a browser
that is slow. All arms are moved by the thread that serves; other threads only wait for what it answers.
"""

from __future__ import annotations

import ipaddress
import itertools
import json
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TooLate
from contextlib import suppress
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from typing import Any, Self, cast

from reachlab.settings.validation import InputError

LOCAL = "127.0.0.1"
"""Address of this machine that no other reaches."""

PATIENCE = 10.0
"""Time for which a connection may keep silent, and in which an arm has to be moved [s]; compiling takes longer."""

COMPILING = 120.0
"""Time in which an arm is there for the first time [s]."""

MOST_CONNECTIONS, MOST_BYTES = 64, 65536
"""Connections at once, and the length of what a page may ask for."""

AT_ONCE = 65536
"""Bytes of the page that are sent at once."""

PORTS = 20
"""Ports that are tried, one after the other."""

SILENCE = 1.0
"""Time after which another page moves the arm than the one that did [s]."""

POLL = 0.1
"""Time between two checks whether serving has ended [s]."""


@dataclass
class Question:
    """What a page asks for, and the place of its answer."""

    page: str
    text: bytes
    answer: Future[dict[str, Any]] = field(default_factory=Future)


class PageServer:
    """Serves one page.

    Attributes:
        url: where the browser finds it.
    """

    def __init__(self, host: str, port: int) -> None:
        """Server on an address and a port, or on one of those after it where it is taken.

        Raises:
            InputError: the address is not this machine's, or none of these ports can be used.
        """
        self._parts: list[bytes] = []
        self._whole = self._closed = False
        self._grown = threading.Condition()
        self._questions: queue.SimpleQueue[Question] = queue.SimpleQueue()
        self._mover, self._moved = "", 0.0
        self._http = _listening(host, port, self)
        self.url = f"http://{host.lower()}:{self._http.server_address[1]}"
        threading.Thread(target=self._http.serve_forever, args=(POLL,), daemon=True).start()

    def __enter__(self) -> Self:
        """Use it until it is closed."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Stop listening."""
        with self._grown:
            self._closed = True
            self._grown.notify_all()
        self._http.shutdown()
        self._http.server_close()

    def add(self, part: str, *, last: bool = False) -> None:
        """Add a part of the page: browsers that ask for it have it at once."""
        with self._grown:
            self._parts.append(part.encode(errors="replace"))
            self._whole = last
            self._grown.notify_all()

    def parts(self) -> Iterator[bytes]:
        """The page's parts, each as soon as it is there."""
        for number in itertools.count():
            with self._grown:
                self._grown.wait_for(lambda number=number: len(self._parts) > number or self._whole or self._closed)
                if len(self._parts) <= number:
                    return
                part = self._parts[number]
            yield part

    def ask(self, question: Question) -> dict[str, Any]:
        """Answer to a question; it is given by the thread that serves.

        Raises:
            TooLate: nobody answers in time.
            InputError: what is asked for is not allowed.
        """
        self._questions.put(question)
        return question.answer.result(COMPILING)

    def serve(self, arms: Sequence[Callable[[], Any]], ended: Callable[[], bool]) -> None:
        """Move arms for pages until it has ended; each `Remote` is made when it is first asked for."""
        made: dict[int, Any] = {}
        while not ended():
            with suppress(queue.Empty):
                self._answer(self._questions.get(timeout=POLL), arms, made)

    def _answer(self, question: Question, arms: Sequence[Callable[[], Any]], made: dict[int, Any]) -> None:
        from reachlab.watch.page.remote import read_asked

        try:
            asked = read_asked(question.text)
            if asked.run >= len(arms):
                raise InputError(f"run must be below {len(arms)}, got {asked.run}.")
            if asked.run not in made:
                made[asked.run] = arms[asked.run]()
            asked = asked if self._may_move(question.page) else replace(asked, steps=0, proceed=False, follow=None)
            question.answer.set_result(made[asked.run].play(asked))
        except InputError as error:
            question.answer.set_exception(error)

    def _may_move(self, page: str) -> bool:
        """Whether time goes on as this page asks: of several that are open the first one does so."""
        now = time.monotonic()
        if page == self._mover or now - self._moved > SILENCE:
            self._mover, self._moved = page, now
        return page == self._mover


class _Server(ThreadingHTTPServer):
    """A server whose threads end with the process, of so many connections at most."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 2 * MOST_CONNECTIONS

    def __init__(self, address: tuple[str, int], page: PageServer) -> None:
        super().__init__(address, _Handler)
        self.page, self.free = page, threading.Semaphore(MOST_CONNECTIONS)

    def server_bind(self) -> None:
        TCPServer.server_bind(self)  # the one above it asks for the name of the address, which may take seconds

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self.free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # no thread can be started
            self.free.release()
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: anyone may send anything, and go away at any time."""


class _Handler(BaseHTTPRequestHandler):
    """Answers one connection."""

    protocol_version = "HTTP/1.1"
    timeout = PATIENCE
    server_version, sys_version = "reachlab", ""

    def do_GET(self) -> None:
        """Give the page."""
        if not self._is_own():
            self._say(
                HTTPStatus.NOT_FOUND, {"error": "name this machine by its number, as 192.168.0.2, not by a name."}
            )
            return
        if self.path.partition("?")[0] not in ("/", "/index.html"):
            self._say(HTTPStatus.NOT_FOUND, {"error": "there is only the page."})
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Transfer-Encoding", "chunked")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        for part in self._page().parts():
            for start in range(0, len(part), AT_ONCE):  # the time for which it may take nothing counts for each of them
                some = part[start : start + AT_ONCE]
                self.wfile.write(b"%x\r\n%b\r\n" % (len(some), some))
        self.wfile.write(b"0\r\n\r\n")

    def do_POST(self) -> None:
        """Answer what a page asks for."""
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MOST_BYTES:
            self.close_connection = True
            self._say(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"error": f"at most {MOST_BYTES} bytes are read."})
            return
        text = self.rfile.read(int(length))
        # A page of any other server cannot send this type here without asking first, which is not answered.
        if not self._is_own() or self.path != "/play" or self.headers.get_content_type() != "application/json":
            self._say(HTTPStatus.FORBIDDEN, {"error": "only the page itself is answered."})
            return
        try:
            self._say(HTTPStatus.OK, self._page().ask(Question(self.headers.get("X-Page", ""), text)))
        except InputError as error:
            self._say(HTTPStatus.BAD_REQUEST, {"error": str(error)})
        except TooLate:
            self._say(HTTPStatus.SERVICE_UNAVAILABLE, {"error": "the arm was not moved in time."})

    def _page(self) -> PageServer:
        return cast("_Server", self.server).page

    def _is_own(self) -> bool:
        """Whether it was asked by the address that was printed: a name that leads here too may be another page's."""
        host, origin = (self.headers.get(name, "").lower() for name in ("Host", "Origin"))
        return (_is_address(host) or f"http://{host}" == self._page().url) and origin in ("", f"http://{host}")

    def _say(self, status: HTTPStatus, message: dict[str, Any]) -> None:
        text = json.dumps(message, separators=(",", ":")).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (the library's name)
        """Say nothing of what is asked."""


def _is_address(host: str) -> bool:
    """Whether a host is given by its number, or as this machine, and not by a name that anyone may have given it."""
    name = host.rpartition(":")[0] or host
    with suppress(ValueError):
        return bool(ipaddress.ip_address(name.strip("[]")))
    return name == "localhost"


def _listening(host: str, port: int, page: PageServer) -> _Server:
    """HTTP server on the first port that is free.

    Raises:
        InputError: the address is not this machine's, or no port is free.
    """
    if not host:
        raise InputError("host is empty: leave it out, or name an address of this machine, as 0.0.0.0 for all of them.")
    try:
        socket.create_server((host, 0)).close()
    except OSError as error:
        why = str(error.strerror).partition(" (")[0]
        raise InputError(f"host {host!r} is no address of this machine ({why}): leave it out.") from None
    last, why = min(port + PORTS, 65536) - 1, ""
    for one in range(port, last + 1):
        try:
            return _Server((host, one), page)
        except OSError as error:
            why = error.strerror
    raise InputError(f"ports {port} to {last} cannot be listened on ({why}): choose another --port.")


def is_local(host: str) -> bool:
    """Whether no other machine reaches an address."""
    return ipaddress.ip_address(socket.gethostbyname(host)).is_loopback
