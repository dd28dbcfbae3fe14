# SPDX-License-Identifier: Apache-2.0
"""The sample of mutations is the same each time, every mutated module has tests, and kernels run tests that exist."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests import kernels, mutate

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("module", mutate.modules())
def test_each_mutated_module_has_tests(module: str) -> None:
    assert [path for path in mutate.tests_of(module) if not (ROOT / path).exists()] == []


def test_kernels_run_tests_that_are_there() -> None:
    named = (*kernels.FOLDERS, *(path for row in kernels.NUMERIC for path in row), *kernels.SAME_ON_ANY_CPU)
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_the_sample_is_the_same_each_time() -> None:
    module = "multilica/stages/coarse.py"
    few, many = list(mutate.mutants_of(module, 2)), list(mutate.mutants_of(module, 5))
    assert [len(few), len(many)] == [2, 5]
    assert few == many[:2]
    source = (ROOT / module).read_text(encoding="utf-8").splitlines()
    for each in many:
        changed = [pair for pair in zip(source, each.text.splitlines(), strict=False) if len({*pair}) > 1]
        assert (each.before, each.after) in [(before.strip(), after.strip()) for before, after in changed]
        ast.parse(each.text)


def test_excused_survivors_stand_in_their_module() -> None:
    for module, before, after in mutate.excused():
        assert before in (ROOT / module).read_text(encoding="utf-8"), module
        assert before != after
