"""What a check of a declaration says: what was tested, by which evidence, and what to write instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from groundstation.json_types import JsonObject

Verdict = Literal["agrees", "contradicted", "doubtful", "cannot tell"]


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a declaration against the data.

    Attributes:
        name: by which ``--accept-declaration`` takes it.
        tested: what was compared with what.
        evidence: the statistic, in words with its numbers.
        verdict: "contradicted" stops an analysis that does not accept it; "doubtful" is said first.
        says: which declaration explains the flight; empty where it agrees.
        line: to write into the vehicle file, or what to do to the data; empty where nothing is.
    """

    name: str
    tested: str
    evidence: str
    verdict: Verdict
    says: str = ""
    line: str = ""

    def to_dict(self) -> JsonObject:
        """For ``--json``."""
        return {name: getattr(self, name) for name in ("name", "tested", "evidence", "verdict", "says", "line")}

    def sentence(self) -> str:
        """What a reader is told, in one paragraph."""
        said = self.says or f"{self.tested}: {self.verdict}."
        return f"declaration {self.name}: {said} ({self.evidence})" + (f" Write: {self.line}" if self.line else "")
