"""Questions in front of a screen. Abort and kill stay visible and work in front of each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Input, SelectionList, Static

from groundstation.texts import shown
from groundstation.tui.widgets.bars import FlightBar


class Question(ModalScreen[bool]):
    """Yes or no; anything but ``y`` is no."""

    BINDINGS: ClassVar = [Binding("y", "answer(True)", "Yes"), Binding("n,escape", "answer(False)", "No")]

    def __init__(self, text: str):
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        """The question and its two answers."""
        yield FlightBar()
        with Vertical(classes="dialog"):
            yield Static(self._text, markup=False)
            yield Static("y  yes        n  no", classes="keys", markup=False)

    def action_answer(self, yes: bool) -> None:
        """Close with the answer."""
        self.dismiss(yes)


class TypedQuestion(ModalScreen[bool]):
    """Yes only when a word is typed."""

    BINDINGS: ClassVar = [Binding("escape", "give_up", "No")]

    def __init__(self, text: str, word: str):
        super().__init__()
        self._text, self._word = text, word

    def compose(self) -> ComposeResult:
        """The question and a field."""
        yield FlightBar()
        with Vertical(classes="dialog"):
            yield Static(self._text, markup=False)
            yield Input(placeholder=f"type {self._word} and Enter; Escape stops", id="word")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Compare."""
        self.dismiss(event.value.strip() == self._word)

    def action_give_up(self) -> None:
        """No."""
        self.dismiss(False)


class Choice(ModalScreen[list[str] | None]):
    """Some of a list; Enter takes what is marked, Escape leaves it as it was."""

    BINDINGS: ClassVar = [
        Binding("enter", "take", "Take", priority=True),
        Binding("escape", "give_up", "Leave it"),
    ]

    def __init__(self, title: str, offered: Sequence[tuple[str, str]], chosen: Sequence[str], most: int = 3):
        super().__init__()
        self._title, self._offered, self._chosen, self._most = title, offered, chosen, most

    def compose(self) -> ComposeResult:
        """The list, and how it is used."""
        yield FlightBar()
        with Vertical(classes="dialog choice"):
            yield Static(self._title, markup=False)
            entries = [(shown(text), value, value in self._chosen) for text, value in self._offered]
            yield SelectionList[str](*entries, id="choice")
            yield Static("Space marks, Enter takes, Escape leaves it", classes="keys", markup=False)

    def action_take(self) -> None:
        """What is marked, in the order of marking, the newest of too many."""
        self.dismiss(self.query_one(SelectionList).selected[-self._most :])

    def action_give_up(self) -> None:
        """Nothing changes."""
        self.dismiss(None)


MOST = 2_000_000
"""Characters of a page: the log of a long flight."""


class TextPage(ModalScreen[None]):
    """A text to read and close: the help, or a log."""

    BINDINGS: ClassVar = [Binding("escape,q,question_mark,l", "close", "Close")]

    def __init__(self, title: str, text: str):
        super().__init__()
        self._title, self._text = shown(title), shown(text, limit=MOST, lines=True)

    def compose(self) -> ComposeResult:
        """A frame with a text that scrolls."""
        yield FlightBar()
        with VerticalScroll(classes="page") as page:
            page.border_title = self._title
            page.border_subtitle = "Escape closes"
            yield Static(self._text, markup=False)

    def action_close(self) -> None:
        """Close it."""
        self.dismiss()
