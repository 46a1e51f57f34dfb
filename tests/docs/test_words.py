"""The counts of `make words`."""

import pytest

from tests.docs.words import prose, syllables


def test_tables_code_and_comments_do_not_count_and_a_decimal_point_ends_no_sentence() -> None:
    text = """# One heading

<!-- not run: a comment -->
Light falls on it at 30.5 deg. Does `d.at(1).u` move? It
does not!

| a | table of words |
|---|---|

```sh
goniotwin demo
```

- A first item
- [a second](somewhere.md) one
"""
    found = prose(text)
    assert [len(each) for each in found.sentences] == [2, 7, 3, 3, 3, 3]
    assert found.words == 21
    assert found.long == []


def test_a_long_sentence_is_found() -> None:
    assert len(prose("word " * 36 + ". " + "word " * 35 + ".").long) == 1


def test_the_grade_is_the_formula_with_syllables_counted_by_hand() -> None:
    words = "The platypus is seemingly a hybrid of a mammal and a small creature"
    assert sum(map(syllables, words.split())) == 1 + 3 + 1 + 3 + 1 + 2 + 1 + 1 + 2 + 1 + 1 + 1 + 2
    assert prose(f"{words}.").grade == pytest.approx(0.39 * 13 + 11.8 * 20 / 13 - 15.59)
