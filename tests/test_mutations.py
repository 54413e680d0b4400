"""Damaged inputs: every one is used or refused in one line, and a refusal leaves no file."""

from __future__ import annotations

import itertools

import mutation
import pytest
from slow_tests import slow

CASES = 10
"""Cases of each kind in the tests: 16 kinds make 160. `python tests/mutation.py` runs others."""
QUICK_CASES = 3
"""Those of each kind that run without `--all`."""
FIRST_SEED = 20_261_126
"""First seed of the tests. Any other will do; it is fixed so that a failure can be repeated."""


@pytest.fixture(scope="session")
def valid_inputs(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EXCITE_COMPILER", "")
        return mutation.valid_inputs(tmp_path_factory.mktemp("valid"))


@pytest.mark.parametrize(
    "numbers", [range(QUICK_CASES), slow(range(QUICK_CASES, CASES))], ids=["first", "others"]
)
@pytest.mark.parametrize("kind", mutation.KINDS)
def test_damaged_input_is_used_or_refused(kind, numbers, valid_inputs, tmp_path, monkeypatch):
    monkeypatch.setenv("EXCITE_COMPILER", "")
    cases = [mutation.make_case(valid_inputs, FIRST_SEED + k, [kind]) for k in numbers]
    failures = list(mutation.run(cases, tmp_path))
    assert not failures, "\n".join(map(str, failures))


@pytest.mark.slow
def test_valid_inputs_are_accepted(valid_inputs, tmp_path, monkeypatch):
    """The counterpart: without damage every command of the cases ends with exit code 0."""
    monkeypatch.setenv("EXCITE_COMPILER", "")
    for argv in dict.fromkeys(itertools.chain.from_iterable(mutation.COMMANDS.values())):
        ending = mutation.run_here(mutation.undamaged_case(valid_inputs, argv), tmp_path)
        assert ending.code == 0, f"{' '.join(argv)}\n{ending.err[-2000:]}"
