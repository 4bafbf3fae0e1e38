"""The faults of ``python -m tests.mutants`` are programs that differ, and its patterns match files."""

from __future__ import annotations

import ast

from tests import mutants


def test_each_fault_is_another_program() -> None:
    chosen = mutants.drawn(0, 12)
    assert len(chosen) == 12
    for path, number in chosen:
        assert ast.dump(ast.parse(mutants.faulty(path, number)[0])) != ast.dump(ast.parse(path.read_text()))
