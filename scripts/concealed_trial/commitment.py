"""The key: one file, whose salted SHA-256 is published before the first answer."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from excite.errors import UnusableInput


def close(folder: Path, names: Sequence[str]) -> str:
    """Bind the cases' keys into `key.json` with a salt; returns the hash, the same one when it is bound already."""
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
    """SHA-256 of the key, salt and all."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def unlock(folder: Path, sealed: str) -> dict[str, Any]:
    """The cases of a key whose hash is the published one. Raises UnusableInput when it is another."""
    path = folder / "key.json"
    if not path.exists() or digest(path) != sealed:
        raise UnusableInput(
            f"{path}: is not the key whose hash was published ({sealed}); the trial is void"
        )
    cases: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["cases"]
    return cases
