"""Differences between a recorded device and another one, byte by byte."""

from dataclasses import dataclass, replace
from itertools import takewhile, zip_longest

from goniotwin.mocks.transcript import FROM_DEVICE, TO_DEVICE, Exchange, Transfer

SHOWN = 48


@dataclass(frozen=True)
class Difference:
    """Bytes that are not those of the transcript, from its line `line` on; `asked` is the request before."""

    line: int
    direction: str
    recorded: bytes
    replayed: bytes
    asked: bytes = b""
    file: str = ""

    @property
    def places(self) -> list[tuple[int, int | None, int | None]]:
        """Different bytes: position, recorded byte, replayed byte; None for a missing byte."""
        pairs = enumerate(zip_longest(self.recorded, self.replayed))
        return [(k, one, other) for k, (one, other) in pairs if one != other]

    def __str__(self) -> str:
        places = [f"byte {k}: {_hex(one)} recorded, {_hex(other)} now" for k, one, other in self.places]
        direction = "to the device" if self.direction == TO_DEVICE else "from the device"
        more = f", and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        file = f"{self.file}, " if self.file else ""
        return f"{file}line {self.line}, {direction}: " + "; ".join(places[:SHOWN]) + more


def describe_differences(recorded: Transfer | None, now: bytes, end: Transfer | None) -> Difference:
    """Difference between a driver's request and the recorded one; without `recorded`, after the `end` of the transcript."""
    at = recorded or end
    line, file = (at.line, at.file) if at is not None else (0, "")
    return Difference(line, TO_DEVICE, recorded.data if recorded is not None else b"", now, file=file)


def compare_exchanges(recorded: list[Exchange], replies: list[bytes]) -> list[Difference]:
    """Exchange by exchange. Bytes may come one exchange sooner or later: drivers read them when they please.

    Bytes of the device after the last recorded one are no difference: the recording had ended.
    """
    found: list[Difference] = []
    late: list[Transfer] = []  # recorded, not received yet
    early = b""  # received, not recorded yet
    before = None
    for number, (exchange, new) in enumerate(zip(recorded, replies, strict=True)):
        then, now = [*late, *exchange.answers], early + new
        if not _agree(_joined(then), now) and _agree(exchange.reply, new):
            found += _differing(late, early, before)
            then, now = exchange.answers, new
        if _agree(_joined(then), now):
            late, early = _from(then, len(now)), now[len(_joined(then)) :]
            # What has waited since the exchange before will not come any more.
            overdue, stale = max(0, len(_joined(late)) - len(exchange.reply)), max(0, len(early) - len(new))
            found += _differing(_up_to(late, overdue), early[:stale], before)
            late, early = _from(late, overdue), early[stale:]
        else:
            following = (recorded[number + 1].reply, replies[number + 1]) if number + 1 < len(replies) else (b"", b"")
            late, early = _surplus(then, now, *following)
            end = len(_joined(then)) - len(_joined(late))
            found += _differing(_up_to(then, end), now[: len(now) - len(early)], exchange.sent)
        before = exchange.sent
    return found + _differing(late, b"", before)


def _joined(pieces: list[Transfer]) -> bytes:
    return b"".join(piece.data for piece in pieces)


def _from(pieces: list[Transfer], start: int) -> list[Transfer]:
    """Recorded bytes after the first `start`."""
    left = []
    for piece in pieces:
        if start < len(piece.data):
            left.append(replace(piece, data=piece.data[start:]))
        start = max(0, start - len(piece.data))
    return left


def _up_to(pieces: list[Transfer], size: int) -> list[Transfer]:
    first = []
    for piece in pieces:
        if size > 0:
            first.append(replace(piece, data=piece.data[:size]))
        size -= len(piece.data)
    return first


def _agree(one: bytes, other: bytes) -> bool:
    """Whether two byte strings agree over their common length."""
    return one.startswith(other) or other.startswith(one)


def _surplus(then: list[Transfer], now: bytes, next_recorded: bytes, next_reply: bytes) -> tuple[list[Transfer], bytes]:
    """Bytes of a different exchange that fit the next one, on one of the two sides."""
    late, early = _from(then, len(now)), now[len(_joined(then)) :]
    fits = _alike(_joined(late) + next_recorded, early + next_reply) > _alike(next_recorded, next_reply)
    return (late, early) if fits else ([], b"")


def _alike(one: bytes, other: bytes) -> int:
    """Number of equal bytes from the start."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))


def _differing(recorded: list[Transfer], now: bytes, asked: Transfer | None) -> list[Difference]:
    """Line by line of the transcript as long as lengths agree; one difference for all from where they do not."""
    question = asked.data if asked is not None else b""
    if not recorded:
        line, file = (asked.line, asked.file) if asked is not None else (0, "")
        return [Difference(line, FROM_DEVICE, b"", now, question, file)] if now else []
    found: list[Difference] = []
    same_size = len(_joined(recorded)) == len(now)
    for number, piece in enumerate(recorded):
        part = now[: len(piece.data)]
        if part != piece.data and not same_size:
            rest = _joined(recorded[number:])
            return [*found, Difference(piece.line, FROM_DEVICE, rest, now, question, piece.file)]
        if part != piece.data:
            found.append(Difference(piece.line, FROM_DEVICE, piece.data, part, question, piece.file))
        now = now[len(piece.data) :]
    if now:
        found.append(Difference(recorded[-1].line, FROM_DEVICE, b"", now, question, recorded[-1].file))
    return found


def _hex(byte: int | None) -> str:
    return "nothing" if byte is None else f"{byte:02x}"
