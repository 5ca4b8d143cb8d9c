"""Every sentence a finding may say, with typical values of either sign: `python -m benchmarks.sentences` writes
docs/sentences.md.
"""

from __future__ import annotations

from studies.sentences import PAGE, page

if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"written: {PAGE}")
