"""The compiled decoder of blackbox frames. Import where it is used: numba takes a third of a second to load.

Encodings and predictors follow Betaflight's "Blackbox internals" documentation. Frame kinds are numbered I 0, P 1, S 2,
G 3, H 4; E (events) are skipped by their own lengths. A frame counts where a known mark follows it; past a damaged
place frames count again from the next I.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from groundstation.recording.tables import forget_pages

_I, _P, _S, _G, _H = range(5)
_MOST_PER_BYTE, _LEAST_BOUND = 64, 1 << 24  # of memory per byte of the file; real logs make about 15
_FOUND, _DAMAGED, _VALID, _OVERRUNS, _STAMP, _FOUND_ANY = range(6, 12)  # places in the state of a decoder
_BLOCK = 1 << 24
_MARKS = np.full(256, -1, np.int64)
for _number, _mark in enumerate(b"IPSGHE"):
    _MARKS[_mark] = _number


@njit(cache=True)
def _unsigned(data, at):
    """A variable-length whole number; ``at[0]`` moves on, ``at[1]`` becomes 1 past the end."""
    value, shift = np.int64(0), 0
    while shift < 35:
        if at[0] >= len(data):
            at[1] = 1
            return np.int64(0)
        byte = np.int64(data[at[0]])
        at[0] += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value & 0xFFFFFFFF
        shift += 7
    at[1] = 1
    return np.int64(0)


@njit(cache=True)
def _signed(data, at):
    value = _unsigned(data, at)
    return (value >> 1) ^ -(value & 1)


@njit(cache=True)
def _byte(data, at):
    if at[0] >= len(data):
        at[1] = 1
        return np.int64(0)
    at[0] += 1
    return np.int64(data[at[0] - 1])


@njit(cache=True)
def _extended(value, bits):
    """A two's complement number of that many bits."""
    value &= (np.int64(1) << bits) - 1
    return value - (np.int64(1) << bits) if value >> (bits - 1) else value


@njit(cache=True)
def _three(data, at, out, first, variable):
    lead = _byte(data, at)
    kind = lead >> 6
    if kind == 0:
        for i in range(3):
            out[first + i] = _extended(lead >> (4 - 2 * i), 2)
    elif kind == 1 and not variable:
        second = _byte(data, at)
        out[first], out[first + 1], out[first + 2] = _extended(lead, 4), _extended(second >> 4, 4), _extended(second, 4)
    elif kind == 1:
        second = _byte(data, at)
        out[first] = _extended(lead >> 1, 5)
        out[first + 1] = _extended((lead & 1) << 4 | second >> 4, 5)
        out[first + 2] = _extended(second, 4)
    elif kind == 2 and not variable:
        out[first] = _extended(lead, 6)
        out[first + 1], out[first + 2] = _extended(_byte(data, at), 6), _extended(_byte(data, at), 6)
    elif kind == 2:
        second, third = _byte(data, at), _byte(data, at)
        out[first] = _extended((lead & 63) << 2 | second >> 6, 8)
        out[first + 1] = _extended((second & 63) << 1 | third >> 7, 7)
        out[first + 2] = _extended(third, 7)
    else:
        for i in range(3):
            size = (lead >> 2 * i & 3) + 1
            value = np.int64(0)
            for byte in range(size):
                value |= _byte(data, at) << 8 * byte
            out[first + i] = _extended(value, 8 * size)


@njit(cache=True)
def _four(data, at, out, first):
    selector = _byte(data, at)
    half, kept = False, np.int64(0)
    for i in range(4):
        kind = selector >> 2 * i & 3
        value = np.int64(0)
        if kind == 1:
            if not half:
                kept = _byte(data, at)
                value = _extended(kept >> 4, 4)
            else:
                value = _extended(kept, 4)
            half = not half
        elif kind == 2:
            if not half:
                value = _extended(_byte(data, at), 8)
            else:
                high = (kept & 15) << 4
                kept = _byte(data, at)
                value = _extended(high | kept >> 4, 8)
        elif kind == 3:
            one, two = _byte(data, at), _byte(data, at)
            if not half:
                value = _extended(one << 8 | two, 16)
            else:
                value = _extended((kept & 15) << 12 | one << 4 | two >> 4, 16)
                kept = two
        out[first + i] = value


@njit(cache=True)
def _raw(data, at, encoding, count, out):
    """The fields of one frame as they are encoded."""
    field = 0
    while field < count and not at[1]:
        kind = encoding[field]
        if kind == 0:
            out[field] = _signed(data, at)
        elif kind == 1:
            out[field] = _unsigned(data, at)
        elif kind == 3:
            out[field] = -_extended(_unsigned(data, at), 14)
        elif kind == 6:
            group = 1
            while group < 8 and field + group < count and encoding[field + group] == 6:
                group += 1
            present = _byte(data, at) if group > 1 else np.int64(1)
            for i in range(group):
                out[field + i] = _signed(data, at) if present >> i & 1 else np.int64(0)
            field += group - 1
        elif kind == 7 or kind == 10:
            if field + 3 > count:
                at[1] = 1
                return
            _three(data, at, out, field, kind == 10)
            field += 2
        elif kind == 8:
            if field + 4 > count:
                at[1] = 1
                return
            _four(data, at, out, field)
            field += 3
        elif kind == 9:
            out[field] = 0
        else:
            at[1] = 1
        field += 1


@njit(cache=True)
def _predicted(predictor, field, last, before, current, constants, skipped, motor):
    """What a field's predictor gives. Constants: least throttle, reference voltage, least motor output."""
    if predictor == 1:
        return last[field]
    if predictor == 2:
        return 2 * last[field] - before[field]
    if predictor == 3:
        return np.int64((last[field] + before[field]) / 2)  # toward zero, as C divides
    if predictor == 4:
        return constants[0]
    if predictor == 5:
        return current[motor] if motor >= 0 else np.int64(0)
    if predictor == 6:
        return last[field] + 1 + skipped
    if predictor == 8:
        return np.int64(1500)
    if predictor == 9:
        return constants[1]
    if predictor == 11:
        return constants[2]
    return np.int64(0)


@njit(cache=True)
def _event(data, at, resumed):
    """Skip an event; a kind that is not known is damage."""
    kind = _byte(data, at)
    if kind == 0 or kind == 15 or kind == 50:
        _unsigned(data, at)
    elif kind == 13:
        function = _byte(data, at)
        if function < 128:
            _signed(data, at)
        else:
            at[0] += 4
    elif kind == 14:
        resumed[0], resumed[1] = _unsigned(data, at), _unsigned(data, at)
        resumed[2] = 1
    elif kind == 30:
        _unsigned(data, at)
        _unsigned(data, at)
    elif kind == 255:
        at[0] += 11
        resumed[3] = 1
    else:
        at[1] = 1


@njit(cache=True)
def decode(data, stop, layout, marks, part, past, state, rows):
    """Go on decoding main frames up to a byte.

    Args:
        data: the log.
        stop: byte from which no further frame is begun.
        layout: encoding, predictor and sign per kind of frame and field, shape (3, 5, most fields); fields per kind,
            (5,); least throttle, reference voltage, least motor output, (3,); I interval, numerator and denominator of
            the P interval, (3,); field of motor[0] and of the time.
        marks: number of a kind by its mark, shape (256,).
        part: first and last stamp and least step of what is kept, microseconds, shape (3,).
        past: the fields of the last frame, of the one before it, and of the current one, shape (3, fields).
        state: where the next frame begins, whether the data end within a field, loop and time after a pause (2),
            whether one was, whether the log has ended, frames kept, bytes skipped, whether frames count, times the
            clock ran over, last stamp kept (-1 of none), whether there was a frame, shape (12,).
        rows: filled with the fields of each frame that is kept, shape (k, fields); of no rows to count only.
    """
    encoding, predictor, is_signed = layout[0][0], layout[0][1], layout[0][2]
    counts, constants, interval, motor, clock = layout[1], layout[2], layout[3], layout[4][0], layout[4][1]
    fields, size = counts[_I], len(data)
    last, before, current = past[0], past[1], past[2]
    side = np.zeros(encoding.shape[1], np.int64)
    at, resumed = state[:2], state[2:6]
    while at[0] < min(size, stop) and not resumed[3]:
        begin, kind = at[0], marks[data[at[0]]]
        at[0] += 1
        at[1] = 0
        if kind < 0:
            state[_DAMAGED] += 1
            state[_VALID] = 0
            continue
        if kind == 5:
            _event(data, at, resumed)
        elif kind > _P:
            _raw(data, at, encoding[kind], counts[kind], side)
        else:
            _raw(data, at, encoding[kind], fields, current)
        whole = not at[1] and at[0] <= size and (at[0] == size or marks[data[at[0]]] >= 0 or resumed[3])
        if not whole:
            at[0] = begin + 1
            state[_DAMAGED] += 1
            state[_VALID] = 0
            resumed[3] = 0
            continue
        if resumed[2]:
            resumed[2] = 0
            last[0] = resumed[0]
        if kind > _P:
            continue
        if kind == _P and not state[_VALID]:
            state[_DAMAGED] += at[0] - begin
            continue
        skipped = 0
        if kind == _P:
            ahead = last[0] + 1
            while skipped < interval[2] and (ahead + skipped) % interval[0] != 0:
                if ((ahead + skipped) % interval[0] + interval[1] - 1) % interval[2] < interval[1]:
                    break
                skipped += 1
        for field in range(fields):
            p = predictor[kind, field]
            value = current[field] + _predicted(p, field, last, before, current, constants, skipped, motor)
            current[field] = _extended(value, 32) if is_signed[kind, field] else value & 0xFFFFFFFF
        if clock >= 0 and state[_FOUND_ANY] and current[clock] - last[clock] < -(1 << 31):
            state[_OVERRUNS] += 1
        state[_FOUND_ANY] = 1
        if kind == _I:
            before[:] = current
        else:
            before[:] = last
        last[:] = current
        state[_VALID] = 1
        _keep(current, clock, part, state, rows)


@njit(cache=True)
def _keep(current, clock, part, state, rows):
    """Note a frame that is of the part, with the times that its clock of 32 bits ran over."""
    stamp = np.int64(0)
    if clock >= 0:
        stamp = current[clock] + (state[_OVERRUNS] << 32)
        if stamp < part[0] or stamp > part[1]:
            return
        if part[2] > 0 and state[_STAMP] >= 0 and abs(stamp - state[_STAMP]) < part[2]:
            return
        state[_STAMP] = stamp
    if state[_FOUND] < len(rows):
        rows[state[_FOUND]] = current
        if clock >= 0:
            rows[state[_FOUND], clock] = stamp
    state[_FOUND] += 1


def decode_frames(data, start, layout, part):
    """The main frames of a part, shape (k, fields), the time without run-overs; bytes skipped as damaged; whether the
    log ended.

    Raises:
        ValueError: fields that take no bytes would make more samples of the file than a flight controller can log.
    """
    fields = int(layout[1][_I])
    rows = np.empty((0, fields), np.int64)
    for _ in range(2):
        state, past = np.zeros(12, np.int64), np.zeros((3, fields), np.int64)
        state[0], state[_STAMP] = start, -1
        for stop in range(start + _BLOCK, len(data) + _BLOCK, _BLOCK):
            decode(data, stop, layout, _MARKS, part.ticks(1e6), past, state, rows)
            if len(data) > _BLOCK:
                forget_pages(data)
        if len(rows) or not state[_FOUND]:
            break
        if 8 * int(state[_FOUND]) * fields > _MOST_PER_BYTE * len(data) + _LEAST_BOUND:
            raise ValueError(f"{state[_FOUND]} frames of {fields} fields in {len(data)} bytes")
        rows = np.empty((state[_FOUND], fields), np.int64)
    return rows, int(state[_DAMAGED]), bool(state[5])
