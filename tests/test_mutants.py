"""The faults of ``python -m tests.mutants`` are programs that differ, and its patterns match files."""

from __future__ import annotations

import ast

import pytest

from tests import mutants


def test_each_fault_is_another_program() -> None:
    chosen = mutants.drawn(0, 12)
    assert len(chosen) == 12
    for path, number in chosen:
        assert ast.dump(ast.parse(mutants.faulty(path, number)[0])) != ast.dump(ast.parse(path.read_text()))


def test_a_pattern_that_matches_no_file_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutants, "GROUPS", ((("jackbox_env/nothing.py", *mutants.LAW), 1.0),))
    with pytest.raises(AssertionError, match=r"nothing\.py.* matches no file"):
        mutants.drawn(0, 1)
