"""The tables of docs/rig/arrival.md, from the declared checks; `make tables` renews them."""

from pathlib import Path

from goniotwin.drivers.checks import CHECKS
from goniotwin.drivers.checks.by_hand import BY_HAND

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "rig" / "arrival.md"
BY_COMMAND_HEAD = "| | what is verified | moves | what must come | assumed facts behind it |\n|---|---|---|---|---|\n"
BY_HAND_HEAD = "| assumed fact | what you do | what you must see |\n|---|---|---|\n"


def renewed(text: str) -> str:
    """The text of the document with the checks that are declared now."""
    for role in CHECKS:
        rows = [
            f"| {number} | {each.what} | {'yes' if each.moves else 'no'} | {each.expected} | {'; '.join(each.facts)} |\n"
            for number, each in enumerate(CHECKS[role], start=1)
        ]
        text = _between(text, role, BY_COMMAND_HEAD + "".join(rows))
        by_hand = [f"| {fact} | {do} | {see} |\n" for fact, do, see in BY_HAND[role]]
        text = _between(text, f"{role} by hand", BY_HAND_HEAD + "".join(by_hand))
    return text


def _between(text: str, name: str, table: str) -> str:
    before, begin, rest = text.partition(f"<!-- {name} -->\n")
    assert begin, f"{DOCUMENT}: the mark of {name} is missing"
    return f"{before}{begin}{table}{rest[rest.index('<!-- end -->') :]}"


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
