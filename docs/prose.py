"""Converts docstrings of gpusim to reStructuredText: parameters become lists, formulas stay.

It reads Google style (Args, Returns, Raises, Source) and `name: text` in running text.
"""

import inspect
import re

QUOTED = re.compile(r"`([^`]+)`")
HEADING = re.compile(r"(Args|Attributes|Returns|Yields|Raises|Source):")
ENTRY = re.compile(r"([*\w.]+(?:, [*\w.]+)*)(?: \([^)]*\))?: ?(.*)")
TAIL = re.compile(r"(?<=[.\])]) (?=(?:Returns|Gives|Raises|Source:) ?)")


def rst(docstring: str, names=()) -> list[str]:
    """Return lines of reStructuredText. names: parameters or fields; each described one is an item of a list."""
    text, sections = _sections(docstring)
    lines = _paragraphs(text, names)
    for title, body in sections:
        if title not in ("Args", "Attributes", ""):
            lines += [f"**{title}:**", ""]
        if title in ("Args", "Attributes", "Raises"):
            for named, said in _entries(body):
                quoted = ", ".join(f"``{name}``" for name in named)
                lines.append(f"* {quoted}: {escaped(said)}" if named else escaped(said))
            lines.append("")
        else:
            lines += _paragraphs(body, ())
    return lines


def _paragraphs(text, names):
    """Return the lines of all paragraphs of a text."""
    lines = []
    for paragraph in text.split("\n\n"):
        if paragraph.strip():
            lines += [*_paragraph(paragraph.rstrip().strip("\n").split("\n"), names), ""]
    return lines


def _sections(docstring):
    """Split a docstring: the text before the first section, and (title, text) of each section."""
    plain, sections = [], []
    for line in inspect.cleandoc(docstring or "").split("\n"):
        heading = HEADING.fullmatch(line)
        if heading:
            sections.append((heading[1], []))
        elif sections and (line.startswith("    ") or not line):
            sections[-1][1].append(line[4:])
        elif sections:  # text after a section
            sections.append(("", [line]))
        else:
            plain.append(line)
    return "\n".join(plain), [(title, "\n".join(body).strip("\n")) for title, body in sections]


def _entries(body):
    """Return (names, text) of each entry of a section; continued lines are indented."""
    entries = []
    for line in body.split("\n"):
        entry = ENTRY.fullmatch(line)
        if entry:
            entries.append((tuple(entry[1].split(", ")), [entry[2]]))
        elif line.strip() and entries:
            entries[-1][1].append(line.strip())
        elif line.strip():
            entries.append(((), [line.strip()]))
    return [(names, " ".join(text).strip()) for names, text in entries]


def _paragraph(lines, names):
    """Return the lines of a paragraph: text, a block of formulas, or text with a block below it."""
    begin = _begin(names)
    indented = [line.startswith("    ") for line in lines]
    if any(indented) and not (names and any(begin.search(line) for line in lines)):
        first = indented.index(True)
        last = next((i for i in range(first, len(lines)) if not indented[i]), len(lines))
        block = ["::", "", *lines[first:last], ""]
        return [
            *_text(" ".join(lines[:first]), names),
            "",
            *block,
            *(_paragraph(lines[last:], names) if lines[last:] else []),
        ]
    return _text(" ".join(line.strip() for line in lines), names)


def _begin(names):
    """Return a pattern for the begin of a parameter's text: `name: ` or `one, other: ` after a sentence."""
    if not names:
        return re.compile(r"(?!)")
    name = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    return re.compile(rf"(?:^|(?<=[.;:] )|(?<=\] ))((?:{name})(?:, (?:{name}))*): ")


def _text(text, names):
    """Return the lines of running text, with parameters as a list."""
    parts = _begin(names).split(text)
    lines = [escaped(parts[0]).strip()] if parts[0].strip() else []
    after = ""
    if len(parts) > 1:
        parts[-1], _, after = _cut(parts[-1])
        lines.append("")
    for number in range(1, len(parts), 2):
        named = ", ".join(f"``{name}``" for name in parts[number].split(", "))
        lines.append(f"* {named}: {escaped(parts[number + 1].strip())}")
    return [*lines, *(["", escaped(after)] if after else [])]


def _cut(text):
    found = TAIL.search(text)
    return (text[: found.start()], " ", text[found.end() :]) if found else (text, "", "")


def escaped(text: str) -> str:
    """Escape all markup except quoted code; a letter may follow the code, as in a plural."""
    parts = QUOTED.split(text)
    for number, part in enumerate(parts):
        if number % 2:
            parts[number] = f"``{part}``"
        else:
            plain = re.sub(r"([\\*_|])", r"\\\1", part)
            parts[number] = f"\\ {plain}" if number and plain[:1].isalnum() else plain
    return "".join(parts)


def parameter_texts(docstring: str, names) -> dict[str, tuple]:
    """Return the text of each described parameter and all names that share this text."""
    text, sections = _sections(docstring)
    texts = {}
    for title, body in sections:
        if title in ("Args", "Attributes"):
            texts |= {name: (said, named) for named, said in _entries(body) for name in named}
    for paragraph in text.split("\n\n"):
        text = " ".join(line.strip() for line in paragraph.split("\n"))
        parts = _begin(names).split(text)
        if len(parts) > 1:
            parts[-1] = _cut(parts[-1])[0]
        for number in range(1, len(parts), 2):
            said = parts[number + 1].strip()
            texts |= {
                name: (said, tuple(parts[number].split(", "))) for name in parts[number].split(", ")
            }
    return texts
