"""Words and length of sentences of README and site, by page: `make words`. A report, no gate.

A sentence ends at . ! or ?. Tables, code, addresses and comments do not count. The grade is that of Flesch and Kincaid (1975),
0.39 words/sentence + 11.8 syllables/word - 15.59, with a syllable for each group of vowels.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from tests.conftest import REPOSITORY
from tests.docs.snippets import FENCE, pages

LONGEST = 35
OTHERS = [REPOSITORY / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
ODD = re.compile(
    r"\b(whoever|told|tells?|telling|heed(?:s|ed)?|foretold|foretells?|foresee[ns]?|darks|mend(?:s|ed)?|reckon(?:s|ed)?|whiles|"
    r"doubts|wherever|hereby|thereof|whereby|lest|heretofore|by and by|gone on with|begun with|own light|back door|as it were|"
    r"it is stated that|that of|those of)\b",
    re.IGNORECASE,
)
"""Words that a colleague would not use aloud, and two that often stand for a noun that is missing."""


@dataclass(frozen=True)
class Prose:
    """The sentences of a page, each as its words."""

    sentences: list[list[str]]
    odd: list[str]

    @property
    def words(self) -> int:
        return sum(map(len, self.sentences))

    @property
    def mean(self) -> float:
        """Words per sentence."""
        return self.words / max(1, len(self.sentences))

    @property
    def long(self) -> list[str]:
        return [" ".join(each) for each in self.sentences if len(each) > LONGEST]

    @property
    def grade(self) -> float:
        count = sum(syllables(word) for each in self.sentences for word in each)
        return 0.39 * self.mean + 11.8 * count / max(1, self.words) - 15.59


def syllables(word: str) -> int:
    """Groups of vowels, without a silent e at the end."""
    found = len(re.findall(r"[aeiouyäöü]+", word.lower()))
    silent = re.search(r"[^aeiouyl]e$", word.lower()) is not None and found > 1
    return max(1, found - silent)


def prose(text: str) -> Prose:
    """The prose of a page in Markdown: a heading, an item of a list and a paragraph each end a sentence."""
    text = re.sub(r"<!--.*?-->", "", FENCE.sub("", text), flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not re.match(r"\s*\||    \S|\(.*\)=$", line)]
    plain = re.sub(r"<[^>]+>", " ", "\n".join(lines))
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", plain)
    plain = re.sub(r"`[^`]*`", "code", plain)
    plain = re.sub(r"(?<=\d)[.,](?=\d)|\b(e\.g|i\.e|cf|vs)\.", "", plain)
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*#]|\d+\.)\s)", plain)
    sentences = [part for block in blocks for part in re.split(r"[.!?](?=[\s\"')*]|$)", re.sub(r"^\s*\d+\.", "", block))]
    words = [re.findall(r"[A-Za-zÀ-ÿα-ωΑ-Ω0-9'’%-]*[A-Za-zα-ωΑ-Ω0-9][A-Za-zÀ-ÿα-ωΑ-Ω0-9'’%-]*", each) for each in sentences]
    return Prose([each for each in words if each], [match[0].lower() for match in ODD.finditer(plain)])


def page_prose(page: Path) -> Prose:
    return prose(page.read_text(encoding="utf-8"))


def line(name: str, found: Prose) -> str:
    """A line of the report."""
    return f"{name:42} {found.words:5} {len(found.sentences):10} {found.mean:5.1f} {len(found.long):8} {found.grade:6.1f} "


def main() -> None:
    print(f"{'page':42} words  sentences  mean  over {LONGEST}  grade  odd words")
    total: list[Prose] = []
    for page in [*pages(), *OTHERS]:
        found = page_prose(page)
        total.append(found)
        counted = sorted({(found.odd.count(each), each) for each in found.odd}, reverse=True)[:4]
        odd = ", ".join(f"{each} {count}" if count > 1 else each for count, each in counted)
        name = page.relative_to(REPOSITORY).as_posix()
        print(line(name, found), odd)
    whole = Prose([each for one in total for each in one.sentences], [])
    print(line("all", whole))


if __name__ == "__main__":
    main()
