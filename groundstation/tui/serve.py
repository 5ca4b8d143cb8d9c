"""The terminal UI in a browser of this machine. Each page that is opened is a client of its own."""

from __future__ import annotations

import shlex
import socket
import sys
from pathlib import Path
from urllib.parse import urlsplit

from aiohttp import web
from textual_serve.server import Server

from groundstation.errors import BadInput

PORT = 8000
HOST = "127.0.0.1"


class LocalServer(Server):
    """The server of textual-serve, for pages that it made itself.

    A browser lets every page open a websocket to every address, this machine's included; so one is refused unless it
    comes from the page that is served here under a name of this machine.
    """

    async def _make_app(self) -> web.Application:
        """As made by textual-serve, with the word to browsers that no page may frame this one."""
        app = await super()._make_app()
        app.on_response_prepare.append(_not_framed)
        return app

    async def handle_websocket(self, request: web.Request) -> web.WebSocketResponse:
        """Start a client for a page of our own."""
        own = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        if request.host not in own or urlsplit(request.headers.get("Origin", "")).netloc not in own:
            raise web.HTTPForbidden(text=f"open http://{HOST}:{self.port} itself")
        return await super().handle_websocket(request)


async def _not_framed(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
    response.headers["X-Frame-Options"] = "DENY"


def serve(port: int = PORT) -> int:
    """Offer it to a browser on this machine alone, until Ctrl-C.

    Raises:
        BadInput: the port is taken.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise BadInput(
                f"port {port} of this machine cannot be used ({error.strerror}); end what uses it."
            ) from None
    command = shlex.join((sys.executable, "-P", "-m", "groundstation.cli"))
    page = Path(__file__).with_name("page")
    LocalServer(command, host=HOST, port=port, title="groundstation", templates_path=page).serve()
    return 0
