"""Check the language of the project: banned terms, public names, docstrings, line length.

    python scripts/style_check.py [PATH …]   # the complete project without PATH

It prints one line per fault, `file:line: text`, and ends with exit code 1 where there is any.
CONTRIBUTING.md states the purpose of the rules. A term that is right in one place is allowed there
by `ALLOWED`, with the reason.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAX_LINE = 100
"""Longest line of code and text [characters]."""

BANNED = {
    r"\blaws?\b": "friction model, effect",
    r"\bwhat (it|they) (leaves?|takes?)\b|\bwhat is left\b|\bis left over\b": (
        "residual, explained torque"
    ),
    r"\bfore(see|sees|seen|saw|tell|tells|told)\b": "predict (on held-out data)",
    r"\bfeign(s|ed|ing)?\b": "mimicked by a measurement artefact",
    r"\bmends?\b|\bbends? to\b": "fits the model error of another effect",
    r"\bbeside\b": "jointly with, next to",
    r"\bcomes? (again|late|round)\b": "recurs with the period, delayed, completes a period",
    r"\bflanks?\b": "gap boundary",
    r"\bwind(s|ing)? up\b|\bwindup\b": "elastic deflection",
    r"\bfriction (with memory|that fades)\b|\bsprings that slip\b": (
        "presliding hysteresis, Stribeck friction"
    ),
    r"\bafloat\b|\brock(s|ing)\b": "base compliance, oscillates",
    r"\bwaver(s|ed|ing)?\b": "timestamp jitter",
    r"\banother day\b": "session, between-session change",
    r"\b(is|too|most) (loud|quiet)\b|\bloud(er|est)?\b": "residual above the expected RMS",
    r"\bknobs?\b|\bkin\b": "nonlinear parameter, model variant",
    r"\boutsiders?\b|\bsealed?\b": "out-of-catalogue effect, hash commitment",
    r"\bhopeless\b": "successive halving",
    r"\bthe whole way\b": "pipeline, complete trajectory",
    r"\blest\b|\bto and fro\b": "plain English",
    r"\bbodies that could be built\b": "physically consistent",
}
"""Terms of a private idiom and their replacement, as regular expressions.

They apply to text and to the words of identifiers.
"""

ANY_BANNED = re.compile("|".join(BANNED), re.IGNORECASE)
"""The first filter: most texts contain none of them."""

BANNED_NAMES = frozenset({"one", "own", "rest", "found", "told", "made"})
"""Names that no variable, parameter or function may have on its own: they name no noun."""

ALLOWED: dict[str, dict[str, str]] = {
    "scripts/style_check.py": {"*": "the list of banned terms itself"},
    "excite/simulator/effect_instance.py": {"outsider": "key of excite.truth/1"},
    "scripts/concealed_trial/score.py": {"outsider": "key of excite.truth/1"},
    "tests/test_concealed_trial.py": {"outsider": "key of excite.truth/1"},
    "excite/recordings/remark.py": {"waver": "value of a remark's kind in --json documents"},
}
"""Path prefix -> {term: reason}: places in which a banned term is right; "*" allows all terms."""

BAD_BEGINNING = re.compile(r"^(What|Whether|Of)\b")


@dataclass(frozen=True)
class Fault:
    """A place that breaks a rule."""

    path: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}: {self.text}"


def allowed(path: Path, term: str) -> bool:
    """Return True if a term is allowed in a file."""
    name = str(path.relative_to(ROOT))
    return any(
        name.startswith(prefix) and (term in terms or "*" in terms)
        for prefix, terms in ALLOWED.items()
    )


def banned_in(text: str) -> Iterator[tuple[str, str]]:
    """Banned terms in a text, each with what to write instead."""
    if not ANY_BANNED.search(text):
        return
    for pattern, remedy in BANNED.items():
        for match in re.finditer(pattern, text, re.IGNORECASE):
            yield match.group(0).lower(), remedy


def words_of(identifier: str) -> str:
    """The words of an identifier, or of those in a text, separated by blanks."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", identifier).replace("_", " ")


def check_text(path: Path, line: int, text: str) -> Iterator[Fault]:
    """Faults of the words of a text."""
    for term, remedy in banned_in(text):
        if not allowed(path, term):
            yield Fault(path, line, f"'{term}': write {remedy}")


def check_lines(path: Path, text: str) -> Iterator[Fault]:
    """Lines that are too long."""
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > MAX_LINE and not line.lstrip().startswith(("|", "![")):
            yield Fault(path, number, f"{len(line)} characters, at most {MAX_LINE}")


def check_markdown(path: Path) -> Iterator[Fault]:
    """Faults of a Markdown file."""
    text = path.read_text(encoding="utf-8")
    for number, line in enumerate(text.splitlines(), 1):
        yield from check_text(path, number, line)


def check_tokens(path: Path, text: str) -> Iterator[Fault]:
    """Banned terms in comments, strings and identifiers."""
    if not (ANY_BANNED.search(text) or ANY_BANNED.search(words_of(text))):
        return  # nor does any token of it contain one; splitting it into tokens takes long
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.COMMENT, tokenize.STRING):
            yield from check_text(path, token.start[0], token.string)
        elif token.type == tokenize.NAME:
            yield from check_text(path, token.start[0], words_of(token.string))


def check_names(path: Path, tree: ast.Module) -> Iterator[Fault]:
    """Variables, parameters and functions whose name is no noun and no verb."""
    for node in ast.walk(tree):
        named: list[tuple[str, int]] = []
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            named = [(node.id, node.lineno)]
        elif isinstance(node, ast.arg):
            named = [(node.arg, node.lineno)]
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            named = [(node.name, node.lineno)]
        for name, line in named:
            if name in BANNED_NAMES and not allowed(path, name):
                yield Fault(path, line, f"'{name}' names nothing: use a noun")


def public_definitions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Public functions and classes of a module, and public methods of these classes."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from (
                    inner
                    for inner in node.body
                    if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_")
                )


def check_docstrings(path: Path, tree: ast.Module) -> Iterator[Fault]:
    """Public names without a docstring, and docstrings that begin as a riddle."""
    if not ast.get_docstring(tree) and tree.body:
        yield Fault(path, 1, "the module has no docstring")
    for definition in public_definitions(tree):
        if any(ast.unparse(decorator) == "overload" for decorator in definition.decorator_list):
            continue  # the implementation below has it
        if not ast.get_docstring(definition):
            yield Fault(path, definition.lineno, f"'{definition.name}' has no docstring")
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
            text = ast.get_docstring(node)
            if text and BAD_BEGINNING.match(text) and not allowed(path, "What"):
                line = 1 if isinstance(node, ast.Module) else node.lineno
                yield Fault(
                    path, line, f"docstring begins with '{text.split()[0]}': say what it is or does"
                )


def check_classes(files: list[Path]) -> Iterator[Fault]:
    """Public classes of the package that share a name."""
    places: dict[str, list[tuple[Path, int]]] = defaultdict(list)
    for path in files:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append((path, node.lineno))
    for name, found_at in places.items():
        others = [place for place in found_at if not allowed(place[0], name)]
        for path, line in others[1:]:
            yield Fault(
                path, line, f"class '{name}' exists also in {others[0][0].relative_to(ROOT)}"
            )


def check_python(path: Path) -> Iterator[Fault]:
    """Faults of a Python file; tests need no docstrings."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    yield from check_lines(path, text)
    yield from check_tokens(path, text)
    yield from check_names(path, tree)
    if "tests" not in path.relative_to(ROOT).parts:
        yield from check_docstrings(path, tree)


def project_files() -> list[Path]:
    """All Python and Markdown files of the project."""
    folders = ("excite", "scripts", "tests", "notebooks", "trajectories")
    inside = [
        path
        for folder in folders
        for pattern in ("*.py", "*.md")
        for path in (ROOT / folder).rglob(pattern)
    ]
    return sorted([*inside, *ROOT.glob("*.md")])


def faults(files: list[Path]) -> list[Fault]:
    """All faults of some files."""
    out = [
        fault
        for path in files
        for fault in (check_python(path) if path.suffix == ".py" else check_markdown(path))
    ]
    package = [
        path for path in files if path.suffix == ".py" and path.is_relative_to(ROOT / "excite")
    ]
    return [*out, *check_classes(package)]


def main() -> int:
    """Print the faults of the files named, or of all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="*", type=Path, metavar="PATH")
    arguments = parser.parse_args()
    named = [path.resolve() for path in arguments.paths]
    files = [
        p for p in project_files() if not named or any(p == n or p.is_relative_to(n) for n in named)
    ]
    found_faults = faults(files)
    for fault in found_faults:
        print(fault)
    print(f"{len(found_faults)} faults in {len(files)} files", file=sys.stderr)
    return 1 if found_faults else 0


if __name__ == "__main__":
    sys.exit(main())
