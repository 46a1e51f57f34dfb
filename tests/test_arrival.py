"""The checklist of docs/rig/arrival.md: its tables are the declared checks, and no assumed fact of a wire is forgotten."""

import re
from pathlib import Path

from goniotwin.drivers.checks import CHECKS
from goniotwin.drivers.checks.by_hand import BY_HAND, NOT_NEEDED
from tests import arrival_list

INTEROPERABILITY = Path(arrival_list.DOCUMENT).with_name("interoperability.md")


def assumed_facts() -> list[str]:
    """The rows of the tables of facts that are assumed, by their first cells."""
    rows = [
        re.split(r" \| ", line.strip("| \n"))
        for line in INTEROPERABILITY.read_text(encoding="utf-8").splitlines()
        if line[:1] == "|"
    ]
    return [row[0] for row in rows if len(row) > 1 and row[0] != "assumed" and "assumed" in row[1].lower()]


def test_the_tables_are_those_of_the_declared_checks() -> None:
    text = arrival_list.DOCUMENT.read_text(encoding="utf-8")
    assert arrival_list.renewed(text) == text, "run `make tables`"


def test_each_assumed_fact_is_verified_or_named_as_not_needed_and_each_name_is_a_fact() -> None:
    verified = {fact for checks in CHECKS.values() for each in checks for fact in each.facts}
    by_hand = {fact for rows in BY_HAND.values() for fact, _, _ in rows}
    names = [*verified, *by_hand, *NOT_NEEDED]
    assert len(set(names)) == len(names)
    facts = assumed_facts()
    assert len(facts) > 50
    assert [fact for fact in facts if sum(fact.startswith(each) for each in names) != 1] == []
    assert [each for each in names if not any(fact.startswith(each) for fact in facts)] == []


def test_what_moves_nothing_comes_first() -> None:
    for checks in CHECKS.values():
        assert [each.moves for each in checks] == sorted(each.moves for each in checks)
