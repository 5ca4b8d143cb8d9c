"""Tables as spreadsheets write them: separators and decimal signs of other countries."""

from __future__ import annotations

import pytest

from groundstation.errors import BadInput
from groundstation.recording.csvfile import header, parse_csv


@pytest.mark.parametrize(
    "data",
    [
        b"t_s,x_m\n0.5,1.25\n1.5,-2.5\n",
        b"t_s;x_m\n0.5;1.25\n1.5;-2.5\n",
        b"t_s;x_m\n0,5;1,25\n1,5;-2,5\n",
        b"t_s\tx_m\n0,5\t1,25\n1,5\t-2,5\n",
        b"\xef\xbb\xbft_s\tx_m\r\n0.5\t1.25\r\n1.5\t-2.5\r\n",
        b'"t_s";"x_m"\n"0,5";"1,25"\n"1,5";"-2,5"\n',
    ],
)
def test_separators_and_decimal_commas_are_read(data):
    table = parse_csv(data, "x.csv", frozenset(("t_s", "x_m")))
    assert table.numbers["t_s"].tolist() == [0.5, 1.5]
    assert table.numbers["x_m"].tolist() == [1.25, -2.5]
    assert header(data) == ("t_s", "x_m")


def test_what_may_be_thousands_is_refused():
    with pytest.raises(BadInput, match=r"line 2: '1\.234,5' may be thousands"):
        parse_csv(b"t_s;x_m\n0;1.234,5\n", "x.csv")
