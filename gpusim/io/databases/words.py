"""Names of cameras and lenses, and the search among them by words."""

import difflib
import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

Item = TypeVar("Item")
_PART = re.compile(r"\d+(?:\.\d+)?|[^\W\d_]+")
# words of makers that differ between data bases
_COMPANY = {
    *("corporation", "corp", "company", "co", "ltd", "inc", "ag", "imaging", "optical", "gmbh"),
    *("techwin", "computer", "camera", "digital", "solutions", "eastman", "electric", "film"),
}
_NO_SPACE = re.compile(r"[^\w.]+")


def parts_of(text: str) -> list[str]:
    """Return the words and numbers of a name: "Nikon D750" is nikon, d, 750."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    return _PART.findall(plain)


def key_of(maker: str, model: str) -> str:
    """Return the key under which data bases agree on a camera: maker once, without spaces."""
    words = [word for word in parts_of(maker) if word not in _COMPANY][:2]
    words = words[:1] if words[:1] != ["konica"] else words
    rest = parts_of(model)
    if "pentax" in rest[:2]:  # Ricoh's since 2011, under both makers' names
        words, rest = ["pentax"], rest[rest.index("pentax") :]
    while rest and (rest[0] in words or rest[0] in _COMPANY):
        rest = rest[1:]
    return "".join([*words, *rest])


def search(words: str, items: Iterable[Item], names: Callable[[Item], Sequence[str]]) -> list[Item]:
    """Return the items whose names have all words, best first.

    Numbers must agree whole, so that 750 does not find 7500; words may be the beginnings of words.
    Names that have nothing else come first, then those with whole words, then shorter ones.

    Args:
        words: The user's words.
        items: Where to search.
        names: Returns all names of an item, the main one first.
    """
    wanted = parts_of(words)
    found = []
    for item in items:
        every = names(item)
        rank = _rank(wanted, parts_of(" ".join(every)))
        if rank is not None:
            found.append((rank, len(parts_of(every[0])), every[0], item))
    found.sort(key=lambda one: one[:3])
    return [item for *_, item in found]


def _rank(wanted: Sequence[str], own: Sequence[str]) -> int | None:
    """Return how well a name fits: 0 in this order and adjacent, 1 with whole words, 2; None if not."""
    free = list(own)
    is_whole = True
    for word in wanted:
        if word in free:
            free.remove(word)
            continue
        begins = [one for one in free if one.startswith(word)] if word.isalpha() else []
        if not begins:
            return None
        free.remove(begins[0])
        is_whole = False
    count = len(wanted)
    runs = (list(own[at : at + count]) == list(wanted) for at in range(len(own) - count + 1))
    return 0 if any(runs) else 1 if is_whole else 2


def nearest(words: str, names: Sequence[str], count: int = 5) -> list[str]:
    """Return names that are written like the words, best first, for a misspelling."""
    plain: dict[str, str] = {}
    for one in names:
        plain.setdefault(" ".join(parts_of(one)), one)
    wanted = " ".join(parts_of(words)[:20])
    close = difflib.get_close_matches(wanted, plain, n=count, cutoff=0.5)
    squeezed = {_NO_SPACE.sub("", key).replace(" ", ""): value for key, value in plain.items()}
    more = difflib.get_close_matches(wanted.replace(" ", ""), squeezed, n=count, cutoff=0.6)
    both = [plain[one] for one in close] + [squeezed[one] for one in more]
    return list(dict.fromkeys(both))[:count]
