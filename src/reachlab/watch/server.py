"""The web server that shows a scene to browsers: viser's, on this machine alone and without its own messages."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import socket
from typing import TYPE_CHECKING

from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    import viser

LOCAL = "127.0.0.1"
"""Address of this machine that no other reaches."""

TITLE = "reachlab"
"""Title of the panel and the page."""


def start_server(host: str, port: int) -> viser.ViserServer:
    """Viser's server, which prints nothing when it starts and stops, and shares nothing through its makers' server.

    Raises:
        InputError: viser is not installed, or the address is not this machine's.
    """
    try:
        from viser import ViserServer
    except ImportError:
        raise InputError("viewing needs viser: pip install 'reachlab[viewer]'.") from None
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

    # `verbose` does not switch off the box with addresses.
    with contextlib.redirect_stdout(io.StringIO()):
        return LocalServer(host=host, port=port, label=TITLE, verbose=False)


def is_local(host: str) -> bool:
    """Whether no other machine reaches an address."""
    return ipaddress.ip_address(socket.gethostbyname(host)).is_loopback
