"""Docstrings of gpusim as reStructuredText: parameters become lists, formulas stay as they are written."""

import inspect
import re

QUOTED = re.compile(r"`([^`]+)`")
TAIL = re.compile(r"(?<=[.\])]) (?=(?:Returns|Gives|Raises|Source:) ?)")


def rst(docstring: str, names=()) -> list[str]:
    """Lines of reStructuredText. names: parameters or fields, each an item of a list where the text tells of it."""
    lines = []
    for paragraph in inspect.cleandoc(docstring or "").split("\n\n"):
        if paragraph.strip():
            lines += [*_paragraph(paragraph.rstrip().strip("\n").split("\n"), names), ""]
    return lines


def _paragraph(lines, names):
    """A paragraph: text, a block of formulas, or text and such a block below it."""
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
    """Where the text of parameters begins: `name: ` or `one, other: ` at a sentence's beginning."""
    if not names:
        return re.compile(r"(?!)")
    name = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    return re.compile(rf"(?:^|(?<=[.;:] )|(?<=\] ))((?:{name})(?:, (?:{name}))*): ")


def _text(text, names):
    """Running text; what it says of parameters as a list."""
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
    """Text in which nothing but quoted code has a meaning to Sphinx; a plural's s stands beside code."""
    parts = QUOTED.split(text)
    for number, part in enumerate(parts):
        if number % 2:
            parts[number] = f"``{part}``"
        else:
            plain = re.sub(r"([\\*_|])", r"\\\1", part)
            parts[number] = f"\\ {plain}" if number and plain[:1].isalnum() else plain
    return "".join(parts)


def what_is_said(docstring: str, names) -> dict[str, tuple]:
    """Text of each parameter that a docstring tells of, with the others that are told of together with it."""
    told = {}
    for paragraph in inspect.cleandoc(docstring or "").split("\n\n"):
        text = " ".join(line.strip() for line in paragraph.split("\n"))
        parts = _begin(names).split(text)
        if len(parts) > 1:
            parts[-1] = _cut(parts[-1])[0]
        for number in range(1, len(parts), 2):
            said = parts[number + 1].strip()
            told |= {
                name: (said, tuple(parts[number].split(", "))) for name in parts[number].split(", ")
            }
    return told
