"""Plan files."""

from __future__ import annotations

from pathlib import Path

from groundstation.errors import BadInput
from groundstation.trajectory import Plan
from groundstation.writing import write_whole


def write_plan(found: Plan, path: Path) -> Path:
    """Write a plan file."""
    import tomli_w

    from groundstation.trajectory import plan_to_dict

    try:
        write_whole(path, tomli_w.dumps(plan_to_dict(found)))
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists.") from None
    return path
