"""Conversations with a vehicle as generators: they say what to send and what to wait for; someone else owns port and
clock.

A conversation yields :class:`Ask` (send, and wait for an answer that fits, again after each time-out) or
:class:`Listen` (wait for any message). It is sent the answer, or None when none came, and returns its result.
:class:`Conversation` runs one on injected time.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from drivers.mavlink.dialect import Message

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Ask:
    """Send messages until one that ``fits`` comes back.

    Attributes:
        send: what goes out at each try.
        fits: recognises the answer.
        timeout_s: wait per try.
        tries: give up after so many; the conversation is then sent None.
    """

    send: tuple[Message, ...]
    fits: Callable[[Message], bool]
    timeout_s: float = 1.0
    tries: int = 4


def listen(fits: Callable[[Message], bool], timeout_s: float) -> Ask:
    """Wait for a message without sending anything."""
    return Ask((), fits, timeout_s, 1)


Steps = Generator[Ask, Any, T]


class Conversation(Generic[T]):
    """Runs one generator of :class:`Ask` on injected time.

    Attributes:
        done: it has returned (``result``) or failed (``error``).
    """

    def __init__(self, steps: Steps[T]):
        self._steps = steps
        self._ask: Ask | None = None
        self._tries = 0
        self._due_s = 0.0
        self.done = False
        self.result: T | None = None
        self.error: Exception | None = None

    def step(self, now_s: float, messages: Iterable[Message]) -> list[Message]:
        """Feed what came, get what to send."""
        out: list[Message] = []
        if self._ask is None and not self.done:
            self._advance(None, now_s, out)
        for message in messages:
            if self.done:
                return out
            if self._ask is not None and self._fits(message):
                self._advance(message, now_s, out)
        while not self.done and self._ask is not None and now_s >= self._due_s:
            if self._tries >= self._ask.tries:
                self._advance(None, now_s, out)
            else:
                self._send(now_s, out)
        return out

    def cancel(self) -> None:
        """Stop here; nothing more is sent."""
        self._steps.close()
        self.done = True

    def _fits(self, message: Message) -> bool:
        """Whether it is the answer; a question that cannot be put to a message ends the conversation, not its owner."""
        assert self._ask is not None  # noqa: S101 - `step` asked
        try:
            return self._ask.fits(message)
        except Exception as error:
            self.done, self.error = True, error
            return False

    def _advance(self, answer: Message | None, now_s: float, out: list[Message]) -> None:
        try:
            self._ask = next(self._steps) if self._ask is None else self._steps.send(answer)
        except StopIteration as stop:
            self.done, self.result = True, stop.value
            return
        except Exception as error:
            self.done, self.error = True, error
            return
        self._tries = 0
        self._send(now_s, out)

    def _send(self, now_s: float, out: list[Message]) -> None:
        assert self._ask is not None  # noqa: S101 - a conversation that has not ended waits for something
        out.extend(self._ask.send)
        self._tries += 1
        self._due_s = now_s + self._ask.timeout_s
