"""The web server that shows a scene to browsers: viser's, on this machine alone and without its own messages."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import logging
import socket
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from reachlab.settings.validation import InputError, installing

if TYPE_CHECKING:
    import viser

LOCAL = "127.0.0.1"
"""Address of this machine that no other reaches."""

TITLE = "reachlab"
"""Title of the panel and the page."""

WEBSOCKETS = "websockets.server"
"""Logger of the connections."""

ARRIVAL, DRAWING = 3.0, 1.5
"""Time in which a browser comes that was opened at once, and from then until it has drawn the scene [s]."""

POLL = 0.02
"""Time between two looks for a browser [s]."""


def start_server(host: str, port: int) -> viser.ViserServer:
    """Viser's server, which prints nothing when it starts and stops, and shares nothing through its makers' server.

    Raises:
        InputError: viser is not installed, or the address is not this machine's.
    """
    try:
        from viser import ViserServer
    except ImportError:
        raise InputError(f"viewing needs viser: {installing('viewer')}.") from None
    try:
        # Viser tries a thousand ports and waits forever on an address that has none.
        socket.create_server((host, 0)).close()
    except OSError as error:
        why = str(error.strerror).partition(" (")[0]
        raise InputError(f"host {host!r} is no address of this machine ({why}): leave it out.") from None

    class LocalServer(ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            # Any page open in the browser could ask for it: a websocket does not heed where a page is from.
            del verbose

        def stop(self) -> None:
            # Its thread prints a line when it ends, for which this waits.
            with contextlib.redirect_stdout(io.StringIO()):
                super().stop()

    logging.getLogger(WEBSOCKETS).addFilter(_in_one_line)
    # `verbose` does not switch off the box with addresses.
    with contextlib.redirect_stdout(io.StringIO()):
        return LocalServer(host=host, port=port, label=TITLE, verbose=False)


def _in_one_line(record: logging.LogRecord) -> bool:
    """Say of a connection that ends by an error what it was, without its traceback: anyone may send anything."""
    if record.exc_info:
        record.msg, record.args = "reachlab: a connection to the viewer is closed: it sent no message of a browser.", ()
        record.exc_info = None
    return True


def await_picture(server: viser.ViserServer, ended: Callable[[], bool]) -> None:
    """Return once a browser has had time for its first picture, or none has come, or it has ended.

    What is computed beside it takes the processor from it: on two cores the picture would come later.
    """
    there, until = False, time.perf_counter() + ARRIVAL
    while time.perf_counter() < until and not ended():
        if not there and server.get_clients():
            there, until = True, time.perf_counter() + DRAWING
        time.sleep(POLL)


def is_local(host: str) -> bool:
    """Whether no other machine reaches an address."""
    return ipaddress.ip_address(socket.gethostbyname(host)).is_loopback
