"""Print constraints for pip: each dependency in pyproject.toml at its lowest allowed version.

`python .ci/lowest.py plot > lowest.txt && pip install -e '.[plot]' -c lowest.txt` installs them.
Arguments are names of optional dependencies (extras), followed through extras that name other
extras. Each floor must be a version that exists; pip fails for one that does not.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
REQUIREMENT = re.compile(
    r"(?P<name>[\w.-]+)(?:\[(?P<extras>[^]]*)\])?\s*(?:>=\s*(?P<floor>[\w.]+))?\s*(?P<marker>;.*)?"
)


def constraints(project: dict, extras: list[str]) -> list[str]:
    """Return one constraint per dependency with a floor, sorted.

    Args:
        project: The table `project` of pyproject.toml.
        extras: Names of its optional dependencies to include.

    Returns:
        Lines `name==version`, with their environment markers.

    Raises:
        SystemExit: A dependency is not written as `name[extras]>=floor; marker`.
    """
    waiting, seen, lines = [*extras], set(), set()
    requirements = [*project["dependencies"]]
    while requirements or waiting:
        if not requirements:
            extra = waiting.pop()
            if extra not in seen:
                seen.add(extra)
                requirements += project["optional-dependencies"][extra]
            continue
        requirement = requirements.pop()
        match = REQUIREMENT.fullmatch(requirement)
        if match is None:
            sys.exit(f"pyproject.toml: {requirement!r} is not written as name[extras]>=floor")
        if match["name"] == project["name"]:
            waiting += re.findall(r"[\w-]+", match["extras"])
        elif match["floor"]:
            lines.add(f"{match['name']}=={match['floor']}{match['marker'] or ''}")
    return sorted(lines)


if __name__ == "__main__":
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    print("\n".join(constraints(table, sys.argv[1:])))
