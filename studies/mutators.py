"""Mutators: from sound bytes, documents and bundles to hostile ones.

Pure functions of a seed's bytes and a generator.
"""

from __future__ import annotations

import contextlib
import json
import random
import tomllib
from collections.abc import Callable, Mapping
from typing import Any

import tomli_w

Bytes = Callable[[bytes, random.Random], bytes]

NASTY_TEXTS = (
    *("", "../../x", "/x/y", "a/../../b", "\x1b[2J\x1b]0;t\x07", "\u202etxt", "a\nb", "\x00", "\x9b31m", "x" * 5000),
    *("--", "<!--", "]]>", "nan", "inf", "{", "%s%n", "'; DROP", "é" * 200, "\ud7ff", "CON", "."),
)
NASTY_NUMBERS = (
    *(0, -1, 1, 255, 2**31 - 1, -(2**31), 2**32, 2**53 + 1, 2**63 - 1, -(2**63), 2**63, 2**64, 10**40),
    *(0.0, -0.0, 1e-320, 1e308, -1e308, 1e200, 0.1, float("nan"), float("inf"), float("-inf"), 1e-12, 3.0),
)
_NASTY_WORDS = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x00" * 8, b"\xff" * 8, b"\x00\x00\x00\x80", b"\x01\x00\x00\x00")
_TOKENS = (
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e308", b"9" * 400, b"1" + b"0" * 4400, b"", b"true", b"null"),
    *(
        b'"',
        b"'",
        b"[",
        b"]",
        b"{",
        b"}",
        b"=",
        b",",
        b"\n",
        b"\r",
        b"\x1b[2J",
        b"\xc3\x28",
        b"\xef\xbb\xbf",
        b"#",
        b'"""',
    ),
    *(b"[" * 600, b'{"a":' * 600, b"a." * 600, b"[[a]]\n" * 50, b"_", b"t_s", b"../../x"),
)


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    """One bit."""
    body = bytearray(data or b"\0")
    body[rng.randrange(len(body))] ^= 1 << rng.randrange(8)
    return bytes(body)


def overwrite(data: bytes, rng: random.Random) -> bytes:
    """A few bytes, by noise or by the ends of integers' ranges."""
    word = rng.choice(_NASTY_WORDS) if rng.random() < 0.6 else rng.randbytes(rng.randint(1, 12))
    at = rng.randrange(len(data) + 1)
    return data[:at] + word + data[at + len(word) :]


def insert(data: bytes, rng: random.Random) -> bytes:
    """Bytes or a token that a parser acts on."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + (rng.choice(_TOKENS) if rng.random() < 0.7 else rng.randbytes(rng.randint(1, 40))) + data[at:]


def delete(data: bytes, rng: random.Random) -> bytes:
    """A stretch is missing."""
    at, size = rng.randrange(len(data) + 1), rng.choice((1, 2, 8, 64, 1000))
    return data[:at] + data[at + size :]


def repeat(data: bytes, rng: random.Random) -> bytes:
    """A stretch comes again, up to 50 times."""
    at, size = rng.randrange(len(data) + 1), rng.choice((1, 8, 64, 500))
    return data[:at] + data[at : at + size] * rng.choice((2, 3, 50)) + data[at + size :]


def truncate(data: bytes, rng: random.Random) -> bytes:
    """The end is missing."""
    return data[: rng.randrange(len(data) + 1)]


def move(data: bytes, rng: random.Random) -> bytes:
    """A stretch from elsewhere stands here."""
    at, source, size = rng.randrange(len(data) + 1), rng.randrange(len(data) + 1), rng.choice((4, 16, 200))
    return data[:at] + data[source : source + size] + data[at + size :]


def token(data: bytes, rng: random.Random) -> bytes:
    """A word of a text is another one."""
    start = rng.randrange(len(data) + 1)
    begin = next((i for i in range(start, len(data)) if data[i : i + 1].isalnum()), len(data))
    end = next((i for i in range(begin, len(data)) if not (data[i : i + 1].isalnum() or data[i] in b".-_+")), len(data))
    return data[:begin] + rng.choice(_TOKENS) + data[end:]


BYTE_MUTATORS: tuple[Bytes, ...] = (flip_bit, overwrite, overwrite, insert, delete, repeat, truncate, move)
TEXT_MUTATORS: tuple[Bytes, ...] = (*BYTE_MUTATORS, token, token, token)


def mutate_bytes(data: bytes, rng: random.Random, mutators: tuple[Bytes, ...] = BYTE_MUTATORS) -> bytes:
    """One to four mutations after another."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        data = rng.choice(mutators)(data, rng)
    return data


def nasty(rng: random.Random, depth: int = 0) -> Any:
    """A value of any type that a document can hold."""
    kind = rng.randrange(8 if depth < 3 else 5)
    if kind == 0:
        return rng.choice((True, False, None))
    if kind <= 2:
        return rng.choice(NASTY_NUMBERS)
    if kind <= 4:
        return rng.choice(NASTY_TEXTS)
    if kind == 5:
        return [nasty(rng, depth + 1) for _ in range(rng.choice((0, 1, 2, 3, 4, 30)))]
    if kind == 6:
        return {rng.choice(NASTY_TEXTS) or "k": nasty(rng, depth + 1) for _ in range(rng.choice((0, 1, 2)))}
    deep: Any = 0
    for _ in range(rng.choice((10, 39, 45, 200))):
        deep = [deep] if rng.random() < 0.5 else {"a": deep}
    return deep


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every container with each of its keys."""
    found, stack = [], [value]
    while stack:
        here = stack.pop()
        if isinstance(here, dict | list):
            keys = list(here) if isinstance(here, dict) else list(range(len(here)))
            found += [(here, key) for key in keys]
            stack += [here[key] for key in keys]
    return found


def mutate_document(document: Any, rng: random.Random) -> Any:
    """Values replaced, removed, renamed, moved or repeated, one to four of them. The document is changed in place."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        places = _places(document)
        if not places:
            return nasty(rng)
        holder, key = rng.choice(places)
        how = rng.randrange(6)
        if how <= 2:
            holder[key] = nasty(rng)
        elif how == 3:
            del holder[key]
        elif how == 4:
            other, place = rng.choice(places)
            with contextlib.suppress(KeyError, IndexError):
                holder[key] = json.loads(json.dumps(other[place], default=str))
        elif isinstance(holder, dict):
            holder[rng.choice(NASTY_TEXTS) or "k"] = holder.pop(key)
        else:
            holder.extend(list(holder) * rng.choice((1, 20)))
    return document


def mutate_toml(data: bytes, rng: random.Random) -> bytes:
    """A TOML file: its document, where that can be written, else its text."""
    if rng.random() < 0.6:
        with contextlib.suppress(TypeError, ValueError, RecursionError, AttributeError):
            return tomli_w.dumps(mutate_document(tomllib.loads(data.decode()), rng)).encode("utf-8", "replace")
    return mutate_bytes(data, rng, TEXT_MUTATORS)


def mutate_json(data: bytes, rng: random.Random) -> bytes:
    """A JSON file: its document, or its text."""
    if rng.random() < 0.6:
        with contextlib.suppress(TypeError, ValueError, RecursionError):
            return json.dumps(mutate_document(json.loads(data), rng)).encode("utf-8", "replace")
    return mutate_bytes(data, rng, TEXT_MUTATORS)


def mutate_lines(data: bytes, rng: random.Random) -> bytes:
    """A file of one JSON document a line: one of the lines, or the text."""
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    if lines[at] and rng.random() < 0.7:
        lines[at] = mutate_json(lines[at], rng)
        return b"\n".join(lines)
    return mutate_bytes(data, rng, TEXT_MUTATORS)


def mutate_named(name: str, data: bytes, rng: random.Random) -> bytes:
    """A file by what its name says it is."""
    if name.endswith(".toml"):
        return mutate_toml(data, rng)
    if name.endswith(".jsonl"):
        return mutate_lines(data, rng)
    if name.endswith((".json", ".journal")):
        return mutate_json(data, rng)
    return mutate_bytes(data, rng, TEXT_MUTATORS if name.endswith(".csv") else BYTE_MUTATORS)


def mutate_folder(files: Mapping[str, bytes], rng: random.Random) -> dict[str, bytes]:
    """Files by name: one changed, and now and then one missing, renamed, or holding what another holds."""
    made = dict(files)
    name = rng.choice(sorted(made))
    made[name] = mutate_named(name, made[name], rng)
    if rng.random() < 0.1:
        other = rng.choice(sorted(made))
        how = rng.randrange(3)
        if how == 0:
            del made[other]
        elif how == 1:
            made[f"x{other}"] = made.pop(other)
        else:
            made[other] = made[rng.choice(sorted(made))]
    return made
