"""Counts idioms that readers have to translate back into plain English, and participles as names.

`python tests/host/test_prose.py` prints the table. `--show GROUP` also prints each place.

Groups of text: docstrings and comments of gpusim and kernels; pages, scripts and examples in docs;
README files and CHANGELOG; docstrings and comments of bench; help texts of all commands. Figures
are per 10,000 words. Code blocks in pages are left out.
"""

import ast
import contextlib
import io
import os
import re
import sys
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MOST, MOST_PARTICIPLES = 5.0, 0.02  # [per 10,000 words], share of all functions
IDIOMS = {
    "what (noun)": (
        r"(?:(?<=[.:;,(] )|(?<=^))[Ww]hat "
        r"(?:is|are|was|a|an|the|it|they|one|this|that|pixels|planes|each|light|of|there|in)\b"
        r"|\b(?:of|to|by|for|from|with|than|as|in|and|is|or) what\b"
    ),
    "where (if)": (
        r"[ ,]where (?:it|they|there|a|an|the|that|this|one|he|no|all|some|these|none|those"
        r"|either|both)\b"
    ),
    "that/those of": r"\b(?:that|those) of\b",
    "alone": r"\balone\b",
    "beside": r"\bbeside\b",
    "told/tells": r"\b(?:told|tells|tell)\b",
}
OTHERS = {  # printed, not judged
    "of which": r"\bof which\b",
    "as many as": r"\bas (?:many|much|few|little|far|large|long) as\b",
    "is to be": r"\bto be had\b|\b(?:is|are|was) to be\b",
    "by its": r"\bby (?:what|that|those|its|their|which|the)\b",
    "asked for": r"\basked for\b",
    "such as": r"\bsuch as\b",
    "of its own": r"\bof (?:its|their|one's|his) own\b",
    "so that": r"\bso that\b",
    "anew": r"\banew\b",
    "alike": r"\balike\b",
    "such a": r"\bsuch (?:a|an)\b",
}
# participles that do not end in -ed and differ from the verb's plain form (read, set, cut, run)
IRREGULAR = set(
    "begun brought built chosen done drawn found given gone grown held hidden kept known "
    "laid left lent lost made meant met paid said seen sent shown sought spent taken thought "
    "thrown told worn written".split()
)
NOT_PARTICIPLES = set("bed embed exceed feed indeed need proceed red seed shed speed".split())
AFTER = set("afar again anew at away back by for from in into of on out there to with".split())
VERBS = set(
    "add are as build can check decode draw get has have is make needs read require set "
    "transform was write".split()
)


def words(text):
    """Return the number of words, numbers not counted."""
    return len(re.findall(r"[A-Za-z][A-Za-z'-]+", text))


def prose_of_code(path):
    """Yield the docstrings and the blocks of comments of a Python file."""
    source = path.read_text()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            text = ast.get_docstring(node)
            if text:
                yield text
    block, last = [], None
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            if last is not None and token.start[0] > last + 1:
                yield "\n".join(block)
                block = []
            block.append(token.string.lstrip("#: "))
            last = token.start[0]
    if block:
        yield "\n".join(block)


def prose_of_page(path):
    """Yield the paragraphs of a Markdown file without code blocks, code in quotes and links."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.M | re.S)
    text = re.sub(r"`[^`]*`", "``", text)
    yield from re.split(r"\n\n+", re.sub(r"\]\([^)]*\)", "]", text))


def help_of_commands():
    """Yield the help texts of the program and of each of its commands, line by line."""
    from gpusim.cli.main import main

    def text_of(*arguments):
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
            main([*arguments, "--help"])
        usage, _, rest = out.getvalue().partition("\n\n")
        assert usage.startswith("usage: "), usage
        return rest

    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "10000"  # no line is broken
    try:
        whole = text_of()
        names = re.findall(r"(?m)^ {4}([\w-]+) {2,}", whole)
        assert len(names) >= 10, whole
        texts = [whole, *(text_of(name) for name in names)]
    finally:
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
    for text in texts:
        for line in text.split("\n"):
            line = re.sub(r"^ {1,4}\S.*?(?: {2,}|$)", "", line).strip()  # without the option's name
            if line:
                yield line


def code_files(*folders):
    """Return the Python files of folders of the repository, in order."""
    built = ("_build", "generated", "gallery")
    return [
        path
        for folder in folders
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not set(path.relative_to(ROOT).parts) & set(built)
    ]


def group_texts(group):
    """Return the texts of a group: a list of (where, text)."""
    if group == "help":
        return [("help", line) for line in help_of_commands()]
    code, pages = {
        "docstrings": (code_files("gpusim", "kernels"), []),
        "docs": (code_files("docs"), sorted((ROOT / "docs").glob("*.md"))),
        "README": (
            [],
            [ROOT / "README.md", ROOT / "bench" / "README.md", ROOT / "CHANGELOG.md"],
        ),
        "bench": (code_files("bench"), []),
    }[group]
    return [
        *((path, text) for path in code for text in prose_of_code(path)),
        *((path, text) for path in pages for text in prose_of_page(path)),
    ]


GROUPS = ("docstrings", "docs", "README", "bench", "help")


def matches(pattern, text):
    """Return the places of an idiom in a text, line breaks as written or joined: the larger list.

    A break may hide an idiom ("as\\nwhat"), or make a line begin with one.
    """
    joined = re.sub(r"\s+", " ", text)
    found = [
        [
            each[max(0, hit.start() - 40) : hit.end() + 40].replace("\n", " ")
            for hit in re.finditer(pattern, each, re.M)
        ]
        for each in (text, joined)
    ]
    return max(found, key=len)


def count_group(group, idioms):
    """Return the number of words of a group and, for each idiom, its places."""
    texts = group_texts(group)
    places = {
        name: [
            f"{where.relative_to(ROOT) if isinstance(where, Path) else where}: {hit}"
            for where, text in texts
            for hit in matches(pattern, text)
        ]
        for name, pattern in idioms.items()
    }
    return sum(words(text) for _, text in texts), places


def is_participle(word):
    """Return whether a word is a participle that is not a verb's plain form."""
    return word in IRREGULAR or (
        len(word) > 3 and word.endswith("ed") and word not in NOT_PARTICIPLES
    )


def is_bare_participle(name):
    """Return whether a function's name is a participle without a verb phrase.

    `made`, `lens_told` and `hardware_id` are; `is_made`, `light_is_known`, `check_size` (a noun) and `read` are not.
    """
    parts = [part for part in name.strip("_").lower().split("_") if part]
    if not parts or name.startswith("__"):
        return False
    while len(parts) > 1 and parts[-1] in AFTER:
        parts = parts[:-1]
    return is_participle(parts[-1]) and not VERBS.intersection(parts[:-1])


def function_names():
    """Return (file, name) of each function and method of gpusim and kernels."""
    return [
        (path.relative_to(ROOT), node.name)
        for path in code_files("gpusim", "kernels")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]


@pytest.mark.parametrize("group", GROUPS)
def test_prose_is_plain(group):
    """A group has each idiom at most 5 times per 10,000 words; a small one may have one of each."""
    total, places = count_group(group, IDIOMS)
    assert total > 500
    many = {
        name: hits
        for name, hits in places.items()
        if len(hits) > 1 and 1e4 * len(hits) / total > MOST
    }
    assert not many, "\n".join(hit for hits in many.values() for hit in hits)


def test_functions_are_verb_phrases():
    names = function_names()
    bare = [f"{path}: {name}" for path, name in names if is_bare_participle(name)]
    assert len(bare) <= MOST_PARTICIPLES * len(names), "\n".join(bare)


def test_participles_are_recognised():
    for name in ("made", "_told", "made_by", "_looked_at", "lens_chosen", "mean_clamped"):
        assert is_bare_participle(name), name
    for name in ("is_made", "read", "checked_size", "check_given", "_speed", "__set__", "meter"):
        assert not is_bare_participle(name), name


def test_idioms_are_found_across_line_breaks():
    count = {name: len(matches(pattern, PASSAGE)) for name, pattern in IDIOMS.items()}
    assert count == dict(zip(IDIOMS, (2, 1, 2, 1, 1, 2), strict=True))


PASSAGE = """\
What a step gave stands beside the result of
what came before, where there is one. It tells that of a lens alone, and is told those of all."""


def main(arguments):
    """Print the table; with `--show GROUP` also each place of the idioms that are judged."""
    columns = ("docstrings", "docs", "README", "bench", "help")
    counts = {group: count_group(group, IDIOMS | OTHERS) for group in columns}
    print(f"{'per 10,000 words':16}", *(f"{group:>10}" for group in columns))
    print(f"{'words':16}", *(f"{counts[group][0]:10}" for group in columns))
    for idiom in (*IDIOMS, *OTHERS):
        rates = (1e4 * len(places[idiom]) / max(1, total) for total, places in counts.values())
        print(f"{idiom:16}", *(f"{rate:10.1f}" for rate in rates), "" if idiom in IDIOMS else "-")
    names = function_names()
    bare = [(path, name) for path, name in names if is_bare_participle(name)]
    print(
        f"names: {len(bare)} of {len(names)} functions are participles, {len(bare) / len(names):.1%}"
    )
    if "--show" in arguments:
        group = arguments[-1]
        if group == "names":
            print(*(f"{path}: {name}" for path, name in bare), sep="\n")
        else:
            print(*(hit for idiom in IDIOMS for hit in counts[group][1][idiom]), sep="\n")


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    main(sys.argv[1:])
