"""What the program needs at run time: its licences against a list, and what pip-audit found of it."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping
from email.message import Message
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROGRAM = "groundstation"
ALLOWED = {
    *("0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "ISC"),
    *("MIT", "MIT-0", "MIT-CMU", "PSF-2.0", "Zlib", "any-OSI"),
    *(
        "Apache Software License",
        "BSD License",
        "MIT License",
        "ISC License (ISCL)",
        "Python Software Foundation License",
    ),
    # Weak copyleft: used unchanged, as libraries that anyone can replace.
    *("MPL-2.0", "Mozilla Public License 2.0 (MPL 2.0)", "Eclipse Public License 2.0 (EPL-2.0)"),
    *("GNU Lesser General Public License v3 (LGPLv3)", "GNU Lesser General Public License v3 or later (LGPLv3+)"),
}
"""Licences by SPDX identifier, and by the names that older packages give them."""


def runtime(name: str = PROGRAM) -> dict[str, Distribution]:
    """Installed packages that a package needs without its extras, itself left out."""
    found: dict[str, Distribution] = {}
    waiting = [name]
    while waiting:
        key = canonicalize_name(waiting.pop())
        if key in found:
            continue
        found[key] = distribution(key)
        needs = map(Requirement, found[key].requires or ())
        waiting += [need.name for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    return {key: found[key] for key in sorted(found) if key != canonicalize_name(name)}


def licence(about: Message | Any) -> list[list[str]]:
    """What a package's metadata offer: alternatives, each of licences that all hold."""
    if expression := about.get("License-Expression"):
        if "(" in expression:  # whatever the brackets mean, each of them has to be allowed
            return [re.split(r" AND | OR ", re.sub(r"[()]", "", expression))]
        return [alternative.split(" AND ") for alternative in expression.split(" OR ")]
    names = [line.split(" :: ")[-1] for line in about.get_all("Classifier", []) if line.startswith("License :: ")]
    names = [name for name in names if name != "OSI Approved"]
    return [names or [(about.get("License") or "none is named").strip().splitlines()[0]]]


def forbidden(packages: Iterable[tuple[str, Any]]) -> list[str]:
    """A sentence for each package none of whose alternatives is allowed."""
    wrong = []
    for name, about in packages:
        offered = licence(about)
        if not any(set(part) <= ALLOWED for part in offered):
            told = " or ".join(" and ".join(part) for part in offered)
            wrong.append(f"{name}: licence '{told}' is not on the list in .ci/audit.py")
    return wrong


def vulnerabilities(text: str, packages: int) -> tuple[str, bool]:
    """One line on what pip-audit found, and whether it is none.

    A package that the service does not know was not looked at; an answer that is no JSON is none.
    """
    try:
        found: list[Mapping[str, Any]] = json.loads(text)["dependencies"]
    except (ValueError, LookupError, TypeError):
        return "vulnerabilities: not looked for; the index or the audit service does not answer", True
    known = [f"{each['name']} {each['version']}: {v['id']}" for each in found for v in each.get("vulns", ())]
    if known:
        return f"vulnerabilities: {'; '.join(known)}", False
    seen = sum("vulns" in each for each in found)
    missing = "" if seen == packages else "; the audit service does not answer for the others"
    return f"vulnerabilities: none known in {seen} of {packages} packages{missing}", True


def main(arguments: list[str]) -> int:
    """Print one line, or what is wrong; 1 when something is."""
    packages = runtime()
    if arguments[0] == "pins":
        print("\n".join(f"{name}=={package.version}" for name, package in packages.items()))
        return 0
    if arguments[0] == "licences":
        wrong = forbidden((name, package.metadata) for name, package in packages.items())
        print("\n".join(wrong) or f"licences: those of {len(packages)} packages are on the list")
        return 1 if wrong else 0
    path = Path(arguments[1])
    line, fine = vulnerabilities(path.read_text(encoding="utf-8") if path.exists() else "", len(packages))
    print(line)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
