"""Checks that the targets of links exist: files, and places in them. It uses no network.

python docs/links.py docs/_build README.md bench/README.md
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.M | re.S)


class Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, path):
        super().__init__()
        self.links, self.places = [], set()
        self.feed(path.read_text())

    def handle_starttag(self, tag, attributes):
        """Collect anchors and links (called by the parser)."""
        for key, value in attributes:
            if key in ("id", "name") and value:
                self.places.add(value)
            elif key in ("href", "src") and value and tag != "link":
                self.links.append(value)


def headings(text):
    """Return the anchors of a Markdown file's headings."""
    lines = re.findall(r"(?m)^#+ (.*)$", FENCE.sub("", text))
    return {re.sub(r"[^\w\- ]", "", line.strip().lower()).replace(" ", "-") for line in lines}


def pages(path):
    """Return file -> (links, anchors) for a folder of HTML or a Markdown file."""
    if path.is_dir():
        found = {
            file.resolve(): Page(file)
            for file in path.rglob("*.html")
            if "_static" not in file.parts
        }
        return {file: (page.links, page.places) for file, page in found.items()}
    text = path.read_text()
    return {path.resolve(): (LINK.findall(FENCE.sub("", text)), headings(text))}


def broken(given) -> list[str]:
    """Return a line for each broken link; print the number of links checked."""
    known = {file: page for path in given for file, page in pages(path).items()}
    wrong, followed = [], 0
    for file, (links, _) in known.items():
        for link in links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            followed += 1
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            if not target.exists():
                wrong.append(f"{file}: {link}: no such file")
            elif (
                parts.fragment
                and target in known
                and unquote(parts.fragment) not in known[target][1]
            ):
                wrong.append(f"{file}: {link}: no such place")
    print(f"{followed} links of {len(known)} files")
    return wrong


if __name__ == "__main__":
    found = broken([Path(given) for given in sys.argv[1:]])
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(1 if found else 0)
