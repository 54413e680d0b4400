"""Hash commitment to the ground truth: its salted SHA-256 is published before the first answer."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from excite.errors import UnusableInput


def commit(folder: Path, names: Sequence[str]) -> str:
    """Collect the ground truth of all cases in `key.json`, with a salt, unless it exists.

    Args:
        folder: Folder with one `<name>.json` per case.
        names: Names of the cases.

    Returns:
        SHA-256 of `key.json`.
    """
    path = folder / "key.json"
    if not path.exists():
        entries = {
            name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
            for name in sorted(names)
        }
        text = json.dumps(
            {"salt": secrets.token_hex(16), "cases": entries}, sort_keys=True, allow_nan=False
        )
        staged = folder / ".key.json"
        staged.write_text(text, encoding="utf-8")
        staged.rename(path)
    return digest(path)


def digest(path: Path) -> str:
    """Return the SHA-256 of a ground-truth file, salt included."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def open_ground_truth(folder: Path, published: str) -> dict[str, Any]:
    """Return the ground truth of all cases, by name.

    Args:
        folder: Folder of `key.json`.
        published: SHA-256 that was published.

    Raises:
        UnusableInput: The file has another hash.
    """
    path = folder / "key.json"
    if not path.exists() or digest(path) != published:
        raise UnusableInput(
            f"{path}: its hash is not the published one ({published}); the trial is void"
        )
    cases: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["cases"]
    return cases
