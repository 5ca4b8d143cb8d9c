"""Messages read by their layout are those that rosbags decodes one by one, whatever their strings and sequences
hold.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from groundstation.recording.bagfile import _flatten
from groundstation.recording.cdrlayout import Columns, layout_of

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint8 a\nfloat64[] b\nstring[] words\nint16 c\nx/Part[] parts\nfloat32[3] d\n"
        "float64[9] d_covariance\nbool e\nuint64 f\nfloat64[] tail\n"
        + "=" * 80
        + "\nMSG: x/Part\nuint8 n\nfloat64 v\nstring s\n",
        "x/msg/Whole",
    )
)
KIND = "x/msg/Whole"


def definitions(name):
    return STORE.get_msgdef(name).fields


def message(rng):
    t = STORE.types
    header = t["std_msgs/msg/Header"](
        t["builtin_interfaces/msg/Time"](int(rng.integers(9)), 7), "m" * int(rng.integers(4))
    )
    parts = [
        t["x/msg/Part"](int(rng.integers(9)), float(rng.normal()), "p" * int(rng.integers(3)))
        for _ in range(rng.integers(3))
    ]
    words = ["w" * int(rng.integers(6)) for _ in range(rng.integers(3))]
    many = rng.normal(size=rng.choice([0, 1, 3, 70]))
    whole = t[KIND](
        header,
        3,
        rng.normal(size=rng.integers(3)),
        words,
        -5,
        parts,
        rng.normal(size=3).astype("f4"),
        np.ones(9),
        True,
        2**40,
        many,
    )
    return bytes(STORE.serialize_cdr(whole, KIND))


def flattened(data):
    row = {}
    _flatten(STORE.deserialize_cdr(data, KIND), "", row)
    return row


def refused(data):
    raise AssertionError("a message was decoded by the library")


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40))
def test_columns_are_what_the_library_decodes(seed, count):
    rng = np.random.default_rng(seed)
    messages = [message(rng) for _ in range(count)]
    columns = Columns(definitions, KIND, refused)
    for data in messages:
        columns.add(data)
    values = columns.values()
    rows = [flattened(data) for data in messages]
    assert list(columns.names) == list(rows[0])
    expected = [[row.get(name, np.nan) for name in columns.names] for row in rows]
    assert np.array_equal(values, np.array(expected).reshape(values.shape), equal_nan=True)


def test_a_message_that_is_cut_off_or_of_another_encoding_has_no_layout():
    data = message(np.random.default_rng(1))
    for broken in (data[: len(data) // 2], b"\0\0" + data[2:], data[:4], b""):
        with pytest.raises(ValueError, match=r"cut off|plain CDR|longer than its message"):
            layout_of(definitions, KIND, broken)
