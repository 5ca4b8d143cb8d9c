"""The terminal UI in a browser's reach: the page is there, on the loopback interface, and a taken port is a sentence."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

from drivers.bus import free_port
from groundstation.errors import BadInput
from groundstation.tui.app import serve

PATIENCE_S = 30.0


def test_the_page_is_served() -> None:
    port = free_port()
    command = [sys.executable, "-P", "-c", f"from groundstation.tui.app import serve; serve({port})"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            assert "groundstation" in page(f"http://127.0.0.1:{port}/", server)
        finally:
            server.terminate()


def page(address: str, server: subprocess.Popen[bytes]) -> str:
    """The page, once the server is up."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        assert server.poll() is None, "the server ended"
        try:
            with urllib.request.urlopen(address, timeout=5.0) as answer:  # noqa: S310 - loopback
                return answer.read().decode()
        except (urllib.error.URLError, ConnectionError):
            assert time.monotonic() < end_s, "no page"
            time.sleep(0.1)


def test_a_taken_port_is_a_sentence() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInput, match="cannot be used"):
            serve(taken.getsockname()[1])
