"""A headless Chromium over its own DevTools protocol: one page, its keys, and what its websockets carried."""

from __future__ import annotations

import asyncio
import base64
import itertools
import re
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ABSENT = "no Chromium is installed (Debian's package is chromium)"
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--enable-unsafe-swiftshader"),
    *("--window-size=1280,900", "--remote-debugging-port=0"),
)
BROWSERS_OWN = re.compile(r"(^|\.)google(apis)?\.com$")
"""Chromium asks its maker for the time and for updates at every start."""
PATIENCE_S = 60.0


class Page:
    """A page.

    ``terminal`` is all text that websockets brought, without escape sequences; ``hosts`` were asked for something.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse):
        self._socket, self._numbers = socket, itertools.count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._session = ""
        self.terminal, self.faults = "", []
        self.hosts: set[str] = set()
        self._reader = asyncio.create_task(self._read())

    async def open(self, address: str) -> None:
        """Load an address."""
        target = await self.ask("Target.createTarget", url="about:blank")
        attached = await self.ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime"):
            await self.ask(f"{domain}.enable")
        await self.ask("Page.navigate", url=address)

    async def value_of(self, expression: str) -> Any:
        """Of a JavaScript expression; of a promise its outcome."""
        answer = await self.ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        return answer["result"].get("value")

    async def press(self, key: str) -> None:
        """One key that writes a character."""
        common = {"key": key, "text": key, "windowsVirtualKeyCode": ord(key.upper())}
        await self.ask("Input.dispatchKeyEvent", type="keyDown", **common)
        await self.ask("Input.dispatchKeyEvent", type="keyUp", **common)

    async def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for something to hold."""
        end_s = asyncio.get_running_loop().time() + PATIENCE_S
        while not condition():
            assert asyncio.get_running_loop().time() < end_s, (
                f"waited for {what}; the end of the page: {self.terminal[-2000:]}"
            )
            await asyncio.sleep(0.05)

    async def shows(self, text: str) -> None:
        """Wait until the terminal in the page was sent this text; what came before is forgotten."""
        await self.until(lambda: text in self.terminal, f"'{text}'")
        self.terminal = self.terminal[self.terminal.index(text) + len(text) :]

    async def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._answers[number] = asyncio.get_running_loop().create_future()
        session = {"sessionId": self._session} if self._session else {}
        await self._socket.send_json({"id": number, "method": method, "params": parameters, **session})
        return await asyncio.wait_for(self._answers[number], PATIENCE_S)

    async def _read(self) -> None:
        async for message in self._socket:
            document = message.json()
            if "id" in document:
                answer = self._answers.pop(document["id"])
                if "error" in document:
                    answer.set_exception(AssertionError(document["error"]["message"]))
                else:
                    answer.set_result(document["result"])
                continue
            self._note(document["method"], document["params"])

    def _note(self, method: str, said: dict[str, Any]) -> None:
        if method == "Network.webSocketFrameReceived" and said["response"]["opcode"] == 2:
            text = base64.b64decode(said["response"]["payloadData"]).decode("utf-8", "replace")
            self.terminal += re.sub(r"\x1b(\[[0-9;?<>=$]*[a-zA-Z]|.)", "", text)
        elif method == "Network.requestWillBeSent":
            host = re.match(r"(?:https?|wss?)://([^/:]+)", said["request"]["url"])
            self.hosts |= {host[1]} if host and not BROWSERS_OWN.search(host[1]) else set()
        elif method == "Runtime.exceptionThrown":
            self.faults.append(said["exceptionDetails"]["text"])


@asynccontextmanager
async def page(profile: Path) -> AsyncIterator[Page]:
    """A new browser with an empty profile, and a page in it."""
    chromium = await asyncio.create_subprocess_exec(
        str(CHROMIUM),
        *FLAGS,
        f"--user-data-dir={profile}",
        "about:blank",
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        assert chromium.stderr is not None
        async with aiohttp.ClientSession() as session:
            address = await asyncio.wait_for(_address(chromium.stderr), PATIENCE_S)
            async with session.ws_connect(address, max_msg_size=0) as socket:
                yield Page(socket)
    finally:
        chromium.terminate()
        await chromium.communicate()


async def _address(words: asyncio.StreamReader) -> str:
    """Of the DevTools, as the browser says it at its start."""
    async for line in words:
        if found := re.search(rb"DevTools listening on (\S+)", line):
            return found[1].decode()
    raise AssertionError("the browser ended before it could be asked for anything")
