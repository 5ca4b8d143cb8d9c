"""The terminal UI in a browser: the page opens, a key press plans a flight, and no other page can reach it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest

from drivers.bus import free_port
from groundstation.errors import BadInput
from groundstation.trajectory import load_plan
from groundstation.tui.serve import serve
from tests.browser import ABSENT, CHROMIUM, page

PATIENCE_S = 30.0


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Of a running server whose flights go to ``tmp_path/logs``."""
    port = free_port()
    command = [sys.executable, "-P", "-c", f"from groundstation.tui.serve import serve; serve({port})"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as server:
        try:
            wait_for(f"http://127.0.0.1:{port}/", server)
            yield f"127.0.0.1:{port}"
        finally:
            os.killpg(server.pid, signal.SIGTERM)


def wait_for(url: str, server: subprocess.Popen[bytes]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while True:
        assert server.poll() is None, "the server ended"
        try:
            with urllib.request.urlopen(url, timeout=5.0):  # noqa: S310 - loopback
                return
        except (urllib.error.URLError, ConnectionError):
            assert time.monotonic() < end_s, "no page"
            time.sleep(0.1)


@pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)
async def test_in_a_browser_the_page_opens_and_a_key_press_plans_a_flight(address: str, tmp_path: Path) -> None:
    async with page(tmp_path / "profile") as opened:
        await opened.open(f"http://{address}/")
        await opened.shows("Two keys fly a simulated drone")
        await opened.press("2")
        await opened.shows("p plans an excitation")
        await opened.press("p")
        await opened.shows("searching a plan for qball2")
        await opened.press("c")
        await opened.shows("criterion condition, cond(W)")
        await opened.press("w")
        written = tmp_path / "logs" / "plans" / "qball2-1.toml"
        await opened.until(written.is_file, "the plan's file")
        assert load_plan(written).vehicle == "qball2"
        assert await opened.value_of("document.title") == "groundstation"
        assert opened.hosts == {"127.0.0.1"}
        assert opened.faults == []


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://elsewhere.example"}, {}, {"Host": "elsewhere.example", "Origin": "http://elsewhere.example"}],
)
async def test_another_page_cannot_reach_the_station(address: str, headers: dict[str, str]) -> None:
    async with aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(f"ws://{address}/ws", headers=headers)
        assert refused.value.status == 403
        own = await session.ws_connect(f"ws://{address}/ws", headers={"Origin": f"http://{address}"})
        await own.close()


def test_a_taken_port_is_a_sentence() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadInput, match="cannot be used"):
            serve(taken.getsockname()[1])


async def test_no_page_may_frame_what_is_served(address: str) -> None:
    async with aiohttp.ClientSession() as session:
        for path in ("/", "/static/js/textual.js", "/nothing-here"):
            async with session.get(f"http://{address}{path}") as answer:
                assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'", path
                assert answer.headers["X-Frame-Options"] == "DENY", path
