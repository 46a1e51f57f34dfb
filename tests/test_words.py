"""Plain technical English: words that make prose hard to read in a second language are counted; none is left.

`python tests/test_words.py [PATH ...]` lists the places.
"""

import re
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
FORBIDDEN = (
    # persons where there are none
    "nobody",
    "somebody",
    "anybody",
    "whoever",
    "who",
    # verbs of speech for data
    "told",
    "tell",
    "tells",
    "telling",
    "said",
    "say",
    "says",
    "saying",
    "heed",
    "heeds",
    "heeded",
    "foretold",
    "foretell",
    "foretells",
    "foreseen",
    "foresee",
    "foresees",
    # words that the field does not have
    "darks",
    "mend",
    "mends",
    "mended",
    "reckon",
    "reckoned",
    "by and by",
    "gone on with",
    "begun with",
    "own light",
    "in between whiles",
    "it is its own",
    "back door",
    "doubts",
    "automatic gains",
    "left out",
)
ALLOWED = {
    # names that others read: keys of JSON answers
    "foretold_s",
    '"told"',
    # the name of a stream of random numbers, which decides the numbers
    "foreseen readings",
    # an option of systemd-inhibit
    "--who=",
    # a column of the golden files
    '"automatic gains"',
}
WORD = re.compile(rf"(?<![A-Za-z])({'|'.join(FORBIDDEN)})(?![A-Za-z])", re.IGNORECASE)
HERE = "tests/test_words.py"


def places(*paths: str) -> list[str]:
    """Each forbidden word in files that git knows: `path:line: word: the line`."""
    command = ["git", "ls-files", "--", *(paths or (".",))]
    files = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.split()
    found = []
    for name in files:
        if (Path(name).suffix not in (".py", ".md", ".toml") and name not in ("Makefile", ".ci/run")) or name == HERE:
            continue
        text = (REPOSITORY / name).read_text(encoding="utf-8")
        if not WORD.search(text):
            continue
        for number, line in enumerate(text.splitlines(), 1):
            rest = line
            for allowed in ALLOWED:
                rest = rest.replace(allowed, "")
            found += [f"{name}:{number}: {match[0]}: {line.strip()}" for match in WORD.finditer(rest)]
    return found


def test_no_forbidden_word_is_left() -> None:
    assert places() == []


if __name__ == "__main__":
    listed = places(*sys.argv[1:])
    print("\n".join(listed))
    print(len(listed), "places")
