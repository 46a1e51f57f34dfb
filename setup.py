"""The long description of the package: README.md without what points into the source tree, which is dead on a package index."""

import re
from pathlib import Path

from setuptools import setup

RELATIVE = r"\((?!https?:|#)[^)\s]*\)"


def without_relative_links(text: str) -> str:
    """Markdown with each relative link as its text alone, and without relative pictures. Code is left as it is."""
    code = re.compile(r"((?s:```.*?```)|^(?: {4}|\t).*$)", re.MULTILINE)
    parts = code.split(text)
    for number in range(0, len(parts), 2):
        part = re.sub(r"<picture>.*?</picture>|<img\b[^>]*>", "", parts[number], flags=re.DOTALL)
        part = re.sub(r"!\[[^]]*\]" + RELATIVE, "", part)
        parts[number] = re.sub(r"\[([^]]*)\]" + RELATIVE, r"\1", part)
    return re.sub(r"\n{3,}", "\n\n", "".join(parts))


if __name__ == "__main__":
    readme = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    readme = readme.partition("\n## Read on\n")[0] + "\nThe source distribution has all pages, in the folder `docs`.\n"
    setup(long_description=without_relative_links(readme), long_description_content_type="text/markdown")
