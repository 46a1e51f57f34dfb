"""The chain of a journal: each committed row has a SHA-256 over all that its values are made from, and over the hash before it.

It shows damage: a changed bit, a missing row, a copy that is torn. It does not show forgery: a program that changes a row can
compute the chain anew. docs/exchange/journal.md describes what is hashed, so that any program can check it.
"""

import bisect
import hashlib
import json
import operator
import sqlite3
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.canonical import CanonicalColumns, encode

ENTRY = "chain"
"""Key in the table `campaign` of the hashes of the other entries and of the plan, and of the last session before the chain."""
NOT_IN_VALUES = ("rig_folder", "versions")
"""Entries that no value depends on, and that differ between computers: the chain does not begin with their hashes."""
PLAN_NUMBERS = "wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg, seconds"
PLAN_TEXTS = "identity, kind, sample, detail"
SESSION = "id, started_s, ended_s, first_link, last_link, outcome, wall_started, wall_ended, rig, versions, tip"
SESSION_NUMBERS = 5
ROW = (
    f"number, attempt, a.session, p.session, started_s, ended_s, {PLAN_NUMBERS}, {PLAN_TEXTS}, positions, flags"
    " FROM {} LEFT JOIN plan p USING (number) LEFT JOIN attempt a USING (number, attempt)"
)
ROW_NUMBERS = 12
READING = "gain_v_per_a, first_s, period_s, monitor_a, readings, channels, counts"
NAMED_ROWS = 5
"""Damaged rows that a message names."""
READING_NUMBERS, PLAN_ROW_NUMBERS = 6, 7


class ChainError(ValueError):
    """An entry that all values depend on is damaged."""


@dataclass(frozen=True)
class Chain:
    """The chain of a journal as found: its length and its tip, the hash of the last link (of the campaign, without rows).

    `damaged` are the rows that differ from what was committed, by number, with their identities; `parts` names what else is
    damaged. `given_up` are damaged rows without a repetition: unplanned ones from before the last resume. `unchecked` is the
    number of attempts from before the chain: they were committed by an earlier version.
    """

    length: int = 0
    tip: str = ""
    unchecked: int = 0
    damaged: dict[int, str] = field(default_factory=dict)
    given_up: dict[int, str] = field(default_factory=dict)
    parts: tuple[str, ...] = ()

    @property
    def damage(self) -> str:
        """What is damaged, as a list in words; empty for a sound journal."""
        return ", ".join([*_named(self.damaged), *self.parts])

    def as_dict(self) -> dict[str, object]:
        """Length and tip, for JSON; `unchecked` rows have no checksums."""
        return {"length": self.length, "tip": self.tip, "unchecked": self.unchecked}

    @property
    def without_values(self) -> dict[int, str]:
        """The rows that have no values because they are damaged."""
        return self.damaged | self.given_up

    @property
    def statement(self) -> str:
        """What a report states of the chain."""
        if not self.length and self.unchecked:
            return "no checksums: an earlier version of the program wrote this journal"
        earlier = f"; {self.unchecked} rows before it have no checksums" if self.unchecked else ""
        return f"{self.length} rows in the chain of checksums, tip {self.tip}{earlier}"


def begin_chain(db: sqlite3.Connection) -> None:
    """Write the hashes of the campaign's entries and of the plan: the chain begins with the next row."""
    (after,) = db.execute("SELECT COALESCE(MAX(id), 0) FROM session").fetchone()
    hashes = {
        key: _hash([key], [value]) for key, value in db.execute("SELECT key, value FROM campaign ORDER BY key").fetchall()
    }
    about = json.dumps({"after_session": after, "sha256": {**hashes, "plan": _plan_hash(db)}})
    db.execute("INSERT INTO campaign VALUES (?, ?)", (ENTRY, about))


def campaign_hash(db: sqlite3.Connection) -> str:
    """The hash with which the chain begins."""
    (about,) = db.execute("SELECT value FROM campaign WHERE key = ?", (ENTRY,)).fetchone()
    return _campaign_hash(*_parse(about))


def add_links(db: sqlite3.Connection, chain: Chain, attempts: Sequence[tuple[int, int]]) -> Chain:
    """Add the links of committed attempts (number, attempt), each once; return the longer chain.

    The rows that they replace are not damaged any more.
    """
    values, given = ", ".join(["(?, ?)"] * len(attempts)), [each for attempt in attempts for each in attempt]
    source = f"(SELECT column1 AS number, column2 AS attempt FROM (VALUES {values}))"
    rows = {row[:2]: row for row in db.execute(f"SELECT {ROW.format(source)}", given)}
    links = {each: link for link, each in enumerate(attempts, chain.length + 1)}
    found = f"SELECT number, attempt, {READING} FROM reading WHERE (number, attempt) IN (VALUES {values}) ORDER BY gain_v_per_a"
    counted: list[Sequence[Any]] = [(links[each[:2]], *each[2:]) for each in db.execute(found, given)]
    counted.sort(key=operator.itemgetter(0))
    tip, added = chain.tip, []
    for (each, link), content in zip(
        links.items(), _after_tip(list(links.values()), [rows[each] for each in attempts], counted), strict=True
    ):
        tip = _tip(tip, *content)
        added.append((link, *each, tip))
    db.executemany("INSERT INTO chain VALUES (?, ?, ?, ?)", added)
    replaced = {number for number, _ in attempts}
    damaged = {key: name for key, name in chain.damaged.items() if key not in replaced}
    return replace(chain, length=chain.length + len(attempts), tip=tip, damaged=damaged)


def seal_session(db: sqlite3.Connection, session: int) -> None:
    """Write the hash of a session's entry, after each change of it."""
    (row,) = db.execute(f"SELECT {SESSION} FROM session WHERE id = ?", (session,)).fetchall()
    db.execute("UPDATE session SET sha256 = ? WHERE id = ?", (_session_hash(row), session))


def check_chain(db: sqlite3.Connection, at_once: int = BlockSizes.checked) -> Chain:
    """Compare all of a journal with its chain, `at_once` rows together. It must not change meanwhile.

    Raises ChainError where an entry is damaged on which all values depend, and sqlite3.Error.
    """
    if db.execute("SELECT 1 FROM sqlite_schema WHERE name = 'chain'").fetchone() is None:
        return Chain(unchecked=db.execute("SELECT COUNT(*) FROM attempt").fetchone()[0])
    factory, db.text_factory = db.text_factory, bytes  # a damaged text may not be UTF-8
    try:
        return _check(db, at_once)
    finally:
        db.text_factory = factory


def _check(db: sqlite3.Connection, at_once: int) -> Chain:
    after, hashes = _check_entries(db)
    parts = [] if _plan_hash(db, at_once) == hashes["plan"] else ["the plan"]
    links = _Links(db, _campaign_hash(after, hashes), at_once)
    sound = links.count - len(links.bad)
    (unchecked,) = db.execute("SELECT COUNT(*) FROM attempt WHERE session <= ?", (after,)).fetchone()
    (checked,) = db.execute("SELECT COUNT(*) FROM attempt WHERE session > ?", (after,)).fetchone()
    damaged = {} if sound == checked and not links.bad else _damaged_rows(db, after, links.bad)
    parts += _check_sessions(db, after, links, rows=bool(damaged))
    given_up = _before_the_resume(db, damaged)
    damaged = {number: name for number, name in damaged.items() if number not in given_up}
    return Chain(links.last, links.tip, unchecked, damaged, given_up, tuple(parts))


def _check_entries(db: sqlite3.Connection) -> tuple[int, dict[str, str]]:
    """The last session before the chain, and the hashes. Raises ChainError for a damaged entry."""
    entries = {_text(key): value for key, value in db.execute("SELECT key, value FROM campaign")}
    if ENTRY not in entries:
        raise ChainError(f"has no entry {ENTRY!r}")
    after, hashes = _parse(entries.pop(ENTRY))
    found = {key: _hash([key], [value]) for key, value in entries.items()}
    for key in sorted(hashes.keys() | found.keys()):
        if key != "plan" and hashes.get(key) != found.get(key):
            raise ChainError(f"its entry {key!r} does not have its checksum")
    if "plan" not in hashes:
        raise ChainError("has no checksum of its plan")
    return after, hashes


class _Links:
    """All links, compared with the rows.

    `bad` are those whose row differs; `gap` is the last link before which one is missing, or 0.
    """

    def __init__(self, db: sqlite3.Connection, tip: str, at_once: int) -> None:
        self.bad: set[int] = set()
        self.count = self.last = self.gap = 0
        self.tip = tip
        self._repaired: str | None = None  # the hash of the last link as computed, where it differs from the stored one
        for block in _linked_rows(db, tip, at_once):
            without_gap = range(self.last + 1, self.last + 1 + len(block.links))
            if block.computed == block.stored and block.links == list(without_gap):
                self.tip, self.last, self.count = block.stored[-1], block.links[-1], self.count + len(block.links)
                self._repaired = None
            else:
                self._compare(block)

    def _compare(self, block: "_LinkedRows") -> None:
        """Compare the links of a block one by one."""
        for link, stored, row, computed in zip(block.links, block.stored, block.rows, block.computed, strict=True):
            sound = computed == stored
            if not sound and self._repaired is not None:  # the damage may be that of the hash before
                sound = _link_hash(self._repaired, link, row, block.readings_of(link)) == stored
            if link != self.last + 1:
                self.gap, sound = link, False
            if not sound:
                self.bad.add(link)
            self._repaired = None if sound else computed
            self.tip, self.last, self.count = stored, link, self.count + 1


@dataclass(frozen=True)
class _LinkedRows:
    """Some links after each other: their numbers, the stored hashes, their rows, and the readings of these.

    Each reading follows the number of its link. `computed` is for each link the hash of row and readings, after the stored
    hash of the link before.
    """

    links: list[int]
    stored: list[str]
    rows: list[Sequence[Any]]
    readings: list[Sequence[Any]]
    computed: list[str]

    def readings_of(self, link: int) -> list[Sequence[Any]]:
        """The readings of one of the links."""
        return [reading[1:] for reading in self.readings if reading[0] == link]


def _linked_rows(db: sqlite3.Connection, tip: str, at_once: int) -> Iterator[_LinkedRows]:
    """All links with their rows, some at a time. Each has the hash before it as it is stored."""
    readings = _readings_by_link(db, at_once)
    found = db.execute(f"SELECT link, sha256, {ROW.format('chain')} ORDER BY link")
    next(readings)
    while block := found.fetchmany(at_once):
        links, stored = [each[0] for each in block], [_text(each[1]) for each in block]
        rows, counted = [each[2:] for each in block], readings.send(block[-1][0])
        before = [tip, *stored[:-1]]
        tip = stored[-1]
        computed = [_tip(each, *content) for each, content in zip(before, _after_tip(links, rows, counted), strict=True)]
        yield _LinkedRows(links, stored, rows, counted, computed)


def _after_tip(links: list[int], rows: Sequence[Sequence[Any]], counted: list[Sequence[Any]]) -> Iterator[tuple[str, bytes]]:
    """Of each link what is hashed after the hash before it: the rest of the JSON list, and the contents."""
    columns = list(zip(*rows, strict=True))
    found = CanonicalColumns([links, *columns[:ROW_NUMBERS]], columns[ROW_NUMBERS:])
    read = zip(*_canonical_readings(links, counted), strict=True)
    of_rows = zip(found.numbers, found.lengths, found.contents, strict=True)
    for (numbers, lengths, contents), (more, further, counts) in zip(of_rows, read, strict=True):
        yield f"{numbers}{more}, {lengths}{further}]", contents + counts


def _tip(before: str, text: str, contents: bytes) -> str:
    """The hash of a link after the hash before it, see `_after_tip`."""
    return hashlib.sha256(b"".join((f"[{json.dumps(before)}, {text}".encode(), contents))).hexdigest()


def _canonical_readings(links: list[int], counted: list[Sequence[Any]]) -> tuple[list[str], list[str], list[bytes]]:
    """For each link what the numbers, the lengths and the contents of its row are continued with: those of its readings."""
    numbers, lengths, contents = [""] * len(links), [""] * len(links), [b""] * len(links)
    if counted:
        of_link: list[int]
        of_link, *read = map(list, zip(*counted, strict=True))
        found = CanonicalColumns(read[:READING_NUMBERS], read[READING_NUMBERS:])
        if of_link == links:  # one reading each, as it often is
            return [f", {each}" for each in found.numbers], [f", {each}" for each in found.lengths], found.contents
        place = {link: k for k, link in enumerate(links)}
        for link, number, length, content in zip(of_link, found.numbers, found.lengths, found.contents, strict=True):
            k = place[link]
            numbers[k] += f", {number}"
            lengths[k] += f", {length}"
            contents[k] += content
    return numbers, lengths, contents


def _readings_by_link(db: sqlite3.Connection, at_once: int) -> Generator[list[Sequence[Any]], int, None]:
    """In the order of the chain the readings up to the link that is sent, of those that were not given before."""
    found = db.execute(
        f"SELECT link, {READING} FROM chain CROSS JOIN reading USING (number, attempt) ORDER BY link, gain_v_per_a"
    )
    known: list[Sequence[Any]] = []
    last = yield known
    while True:
        while not known or known[-1][0] <= last:
            more = found.fetchmany(at_once)
            if not more:
                break
            known += more
        end = bisect.bisect_right(known, last, key=operator.itemgetter(0))
        some, known = known[:end], known[end:]
        last = yield some


def _damaged_rows(db: sqlite3.Connection, after: int, bad: set[int]) -> dict[int, str]:
    """The rows whose last attempt has no sound link, with their identities as they are now."""
    last: dict[int, tuple[int, int]] = {}
    linked, suspects = set(), set()
    for link, number, attempt in db.execute("SELECT link, number, attempt FROM chain ORDER BY link"):
        last[number] = (link, attempt)
        if link in bad:
            suspects.add(number)
        else:
            linked.add((number, attempt))
    for number, attempt in db.execute("SELECT number, attempt FROM attempt WHERE session > ?", (after,)):
        if (number, attempt) not in linked:
            suspects.add(number)
    damaged = {}
    for number in suspects:
        link, attempt = last.get(number, (0, 0))
        (latest,) = db.execute("SELECT MAX(attempt) FROM attempt WHERE number = ?", (number,)).fetchone()
        if link in bad or attempt != latest:
            name = db.execute("SELECT identity FROM plan WHERE number = ?", (number,)).fetchone()
            damaged[number] = "" if name is None else _text(name[0])
    return damaged


def _before_the_resume(db: sqlite3.Connection, damaged: dict[int, str]) -> dict[int, str]:
    """Damaged rows that are not part of the plan, of earlier sessions than the last one: a resume does not repeat them."""
    (last,) = db.execute("SELECT COALESCE(MAX(id), 0) FROM session").fetchone()
    session_of = {number: db.execute("SELECT session FROM plan WHERE number = ?", (number,)).fetchone() for number in damaged}
    return {
        number: damaged[number]
        for number, found in session_of.items()
        if found is not None and found[0] is not None and found[0] < last
    }


def _check_sessions(db: sqlite3.Connection, after: int, links: _Links, *, rows: bool) -> list[str]:
    """What is damaged of the sessions since the chain, and whether the chain ends as the last one states."""
    sessions = db.execute(f"SELECT {SESSION}, sha256 FROM session WHERE id > ? ORDER BY id", (after,)).fetchall()
    damaged = [f"session {row[0]}" for *row, stored in sessions if stored is None or _session_hash(row) != _text(stored)]
    (latest,) = db.execute("SELECT COALESCE(MAX(session), 0) FROM attempt").fetchone()
    if latest > max([after, *(row[0] for row in sessions)]):
        damaged.append(f"session {latest}")
    if not sessions or damaged:
        return damaged
    number, first, last, tip = (sessions[-1][k] for k in (0, 3, 4, 10))
    if links.gap >= first or (last is not None and last > links.last):
        damaged.append(f"rows of session {number}, which are missing")
    elif last is not None and not rows and (last, _text(tip)) != (links.last, links.tip):
        damaged.append(f"the end of session {number}")
    return damaged


def _plan_hash(db: sqlite3.Connection, at_once: int = BlockSizes.checked) -> str:
    found = hashlib.sha256()
    rows = db.execute(f"SELECT number, {PLAN_NUMBERS}, {PLAN_TEXTS} FROM plan WHERE session IS NULL ORDER BY number")
    while block := rows.fetchmany(at_once):
        columns = list(zip(*block, strict=True))
        for content in CanonicalColumns(columns[:PLAN_ROW_NUMBERS], columns[PLAN_ROW_NUMBERS:]).encoded():
            found.update(content)
    return found.hexdigest()


def _campaign_hash(after: int, hashes: dict[str, str]) -> str:
    return _hash([after, *(hashes[key] for key in sorted(hashes) if key not in NOT_IN_VALUES)], [])


def _session_hash(row: Sequence[Any]) -> str:
    return _hash(row[:SESSION_NUMBERS], row[SESSION_NUMBERS:])


def _link_hash(previous: str, link: int, row: Sequence[Any], readings: Sequence[Sequence[Any]]) -> str:
    return _hash(*_link_contents(previous, link, row, readings))


def _link_contents(
    previous: str, link: int, row: Sequence[Any], readings: Sequence[Sequence[Any]]
) -> tuple[Sequence[Any], Sequence[Any]]:
    """Numbers and contents of a link."""
    numbers = [previous, link, *row[:ROW_NUMBERS], *(each for reading in readings for each in reading[:-1])]
    return numbers, [*row[ROW_NUMBERS:], *(reading[-1] for reading in readings)]


def _hash(numbers: Sequence[Any], contents: Sequence[Any]) -> str:
    return hashlib.sha256(encode(numbers, contents)).hexdigest()


def _parse(about: str | bytes) -> tuple[int, dict[str, str]]:
    try:
        found = json.loads(about)
        return int(found["after_session"]), {str(key): str(value) for key, value in found["sha256"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ChainError(f"its entry {ENTRY!r} cannot be read") from None


def _named(rows: dict[int, str]) -> list[str]:
    """Rows in words; beyond NAMED_ROWS their number."""
    named = [f"row {number} ({name})" if name else f"row {number}" for number, name in sorted(rows.items())]
    return [*named[:NAMED_ROWS], *([f"{len(named) - NAMED_ROWS} more rows"] if len(named) > NAMED_ROWS else [])]


def _text(value: str | bytes) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
