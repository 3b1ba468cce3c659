"""Mutations that know nothing of the format: bytes and lines."""

from __future__ import annotations

from random import Random

__all__ = ["EXTREMES", "mutate_bytes", "mutate_lines"]

_TOKENS = [
    b"\x00",
    b"\xff",
    b"\xfe\xff",
    b"\xef\xbb\xbf",
    b"\r",
    b"\n",
    b"\t",
    b"nan",
    b"1e999",
    b"-0",
    b"{",
    b"[",
    b'"',
]
_LONG = 70_000  # [bytes] that are put in at once, at times
_LINES = 2000  # copies of a line

# Numbers at the ends of what they can be, as a person, a program or a broken disk writes them.
EXTREMES = (
    *("0", "-0", "1", "-1", "2", "nan", "-nan", "inf", "-inf", "1e308", "1e309", "-1e300", "1e150", "1e-308"),
    *(
        "5e-324",
        "1e-17",
        "1e17",
        "2147483647",
        "2147483648",
        "-2147483649",
        "4294967296",
        "9223372036854775807",
    ),
    *(
        "9223372036854775808",
        "18446744073709551616",
        "1" + "0" * 400,
        "9" * 5000,
        "0x10",
        "1_0",
        "1,5",
        "1e",
        "",
    ),
    *(
        "0.1e1",
        "+1",
        "--1",
        "1.2.3",
        "٣",
        "1 2",
        "NaN",
        "Infinity",
        "None",
        "true",
        "1j",
        "1e5",
        "-7",
        "0.5",
        "3",
    ),
)


def mutate_bytes(data: bytes, random: Random) -> bytes:
    """Flip, cut, repeat, insert: one to four times."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        data = random.choice(_BYTES)(bytearray(data), random)
    return data


def mutate_lines(text: str, random: Random) -> str:
    """Drop, repeat, swap or cut lines, or put another number in: one to three times."""
    lines = text.split("\n")
    for _ in range(random.choice((1, 1, 2, 3))):
        random.choice(_LINE)(lines, random)
    return "\n".join(lines)


def _flip(data: bytearray, random: Random) -> bytes:
    if data:
        place = random.randrange(len(data))
        data[place] ^= 1 << random.randrange(8)
    return bytes(data)


def _replace(data: bytearray, random: Random) -> bytes:
    if data:
        data[random.randrange(len(data))] = random.choice((0, 255, 10, random.randrange(256)))
    return bytes(data)


def _cut(data: bytearray, random: Random) -> bytes:
    return bytes(data[: random.randrange(len(data) + 1)])


def _drop(data: bytearray, random: Random) -> bytes:
    begin = random.randrange(len(data) + 1)
    del data[begin : begin + random.choice((1, 2, 8, 64, 512))]
    return bytes(data)


def _repeat(data: bytearray, random: Random) -> bytes:
    begin = random.randrange(len(data) + 1)
    part = bytes(data[begin : begin + random.choice((1, 8, 64, 512))])
    data[begin:begin] = part * random.choice((1, 2, 50))
    return bytes(data)


def _insert(data: bytearray, random: Random) -> bytes:
    place = random.randrange(len(data) + 1)
    token = random.choice(_TOKENS)
    data[place:place] = token * (_LONG // len(token)) if random.random() < 0.03 else token
    return bytes(data)


def _number(data: bytearray, random: Random) -> bytes:
    """Another number at the place of one."""
    digits = [i for i, byte in enumerate(data[:100_000]) if 48 <= byte <= 57]
    if digits:
        begin = end = random.choice(digits)
        while end < len(data) and data[end] in b"0123456789.eE+-":
            end += 1
        data[begin:end] = random.choice(EXTREMES).encode()
    return bytes(data)


_BYTES = (_flip, _flip, _replace, _cut, _drop, _repeat, _insert, _number, _number)


def _drop_line(lines: list[str], random: Random) -> None:
    if lines:
        del lines[random.randrange(len(lines))]


def _repeat_line(lines: list[str], random: Random) -> None:
    if lines:
        line = random.choice(lines)
        place = random.randrange(len(lines) + 1)
        lines[place:place] = [line] * random.choice((1, 1, 1, 2, 30, _LINES))


def _swap_lines(lines: list[str], random: Random) -> None:
    if lines:
        i, j = random.randrange(len(lines)), random.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]


def _cut_line(lines: list[str], random: Random) -> None:
    if lines:
        place = random.randrange(len(lines))
        lines[place] = lines[place][: random.randrange(len(lines[place]) + 1)]


def _word(lines: list[str], random: Random) -> None:
    """Another number in place of a word of a line."""
    if lines:
        place = random.randrange(len(lines))
        words = lines[place].split(" ")
        words[random.randrange(len(words))] = random.choice(EXTREMES)
        lines[place] = " ".join(words)


_LINE = (_drop_line, _repeat_line, _swap_lines, _cut_line, _word, _word, _word)
