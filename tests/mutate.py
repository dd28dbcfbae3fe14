# SPDX-License-Identifier: Apache-2.0
"""Mutation testing: change one place of a module at a time, and count the changes that its tests notice.

A sample per module, the same each time. Changes are those of Cosmic Ray, and those that poses invite: an inverse, a
transposition or a conversion left out, target for source, the smallest for the largest. The sources stay as they are:
a copy is changed. Fails below 85 %. `mutation_survivors.toml` has the changes that no test can notice, with a reason.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from importlib import import_module
from itertools import islice
from pathlib import Path

import pytest
from cosmic_ray import plugins
from cosmic_ray.ast import Visitor, get_ast
from cosmic_ray.mutating import mutate_code
from hypothesis import Phase, settings

ROOT = Path(__file__).parents[1]
LEAST_SHARE = 0.85
MUTANTS = 6
OUTPUT = "output.txt"
SEED = 17
SURVIVORS = ROOT / "tests" / "mutation_survivors.toml"
STAGES, REGISTRATION, NUMBERS, SINKS = (
    "tests/unit/stages",
    "tests/unit/registration",
    "tests/sinks/numbers",
    "tests/sinks",
)
AGREE, FILES = f"{NUMBERS}/test_files_agree.py", f"{SINKS}/files/test_result_files.py"
CHECK = "tests/cli/saved_runs/test_check.py"
# The first pattern that a module fits names its tests, the fastest first.
TARGETS = {
    "multilica/geometry.py": ("tests/property/test_geometry.py", "tests/unit/test_derivatives.py"),
    "multilica/extrinsics.py": ("tests/unit/test_extrinsics.py", FILES),
    "multilica/documents.py": ("tests/unit/test_documents.py",),
    "multilica/registration/plane_equations.py": (f"{REGISTRATION}/test_plane_derivatives.py",),
    "multilica/registration/plane_[fm]*.py": (
        f"{REGISTRATION}/test_plane_derivatives.py",
        "tests/unit/registration/test_plane_fit.py",
        "tests/unit/registration/test_biased_rooms.py",
    ),
    "multilica/registration/sensor_biases.py": (
        "tests/unit/registration/test_sensor_biases.py",
        "tests/unit/test_derivatives.py",
    ),
    "multilica/acceptance/consistency.py": ("tests/unit/acceptance/test_consistency.py",),
    "multilica/stages/merge.py": (
        f"{STAGES}/test_merge.py",
        f"{STAGES}/test_merge_along_graph.py",
        f"{STAGES}/test_group_registration.py",
    ),
    "multilica/stages/refine.py": ("tests/unit/test_derivatives.py", f"{STAGES}/test_refine.py"),
    "multilica/stages/stillness.py": ("tests/unit/test_derivatives.py", f"{STAGES}/test_stillness.py"),
    "multilica/stages/known_poses.py": (f"{STAGES}/test_base_frame.py", "tests/pipeline/test_prior.py"),
    "multilica/stages/pair_choice.py": (
        f"{STAGES}/test_pair_choice.py",
        f"{STAGES}/test_target.py",
    ),
    "multilica/stages/preprocess.py": (f"{STAGES}/test_preprocess.py", f"{STAGES}/test_stillness.py"),
    "multilica/stages/ground.py": (f"{STAGES}/test_ground_plane.py", "tests/unit/solvers/test_ground_surface.py"),
    "multilica/stages/fine.py": (f"{STAGES}/test_fine.py", f"{REGISTRATION}/test_stability.py"),
    "multilica/stages/*.py": (f"{STAGES}/test_{{name}}.py",),
    "multilica/sinks/files/atomic.py": (f"{SINKS}/files/test_atomic.py",),
    "multilica/sinks/run_directory.py": (f"{SINKS}/files/test_run_directory.py",),
    "multilica/sinks/files/*.py": (AGREE, FILES, f"{SINKS}/test_contested_place.py"),
    "multilica/sinks/snapshots.py": (
        f"{SINKS}/bags",
        "tests/ingest/test_snapshot_mcap.py",
        "tests/ingest/test_snapshot_metadata.py",
        "tests/exports/test_formats.py",
    ),
    "multilica/sinks/mcap/messages.py": (f"{SINKS}/mcap/test_reading.py", f"{NUMBERS}/test_messages_agree.py"),
    "multilica/sinks/mcap/*.py": (
        f"{NUMBERS}/test_messages_agree.py",
        f"{NUMBERS}/test_encodings_agree.py",
        f"{SINKS}/mcap/test_result_mcap.py",
        f"{SINKS}/mcap/test_result_drawings.py",
        f"{SINKS}/mcap/test_partial_mcap.py",
    ),
    "multilica/results/building.py": (f"{SINKS}/text/test_prior_comparison.py", AGREE, FILES),
    "multilica/sinks/text/*.py": (
        f"{SINKS}/text",
        NUMBERS,
        f"{SINKS}/test_uncertain.py",
        f"{SINKS}/test_unplaced.py",
        f"{SINKS}/rerun/test_pairs.py",
    ),
    "multilica/results/document.py": (AGREE, FILES, "tests/unit/test_documents.py", "tests/diagnosis"),
    "multilica/exports/*.py": ("tests/exports/test_formats.py", "tests/exports/test_conventions.py", "tests/exports"),
    "multilica/checks/*.py": ("tests/checks/test_comparison.py", "tests/checks/test_ci_reports.py", CHECK),
    "multilica/verification.py": ("tests/unit/test_verification.py", CHECK),
}
OPERATORS = (
    "ReplaceBinary|ReplaceComparison|ReplaceUnary|AddNot|ReplaceTrue|ReplaceFalse|ReplaceAnd|ReplaceOr|Number|Zero"
)
CONFUSIONS = (
    (r"\bmax\(", "min("),
    (r"\bmin\(", "max("),
    (r"\.inverse\(\)", ""),
    (r"\.T\b(?!_)", ""),
    (r"\bnp\.(rad2deg|deg2rad)\(", "np.asarray("),
    (r"\b(?:math\.)?(degrees|radians)\(", "float("),
    (r"\brpy_deg\b", "rpy_rad"),
    (r"\.target\b", ".source"),
    (r"\.source\b", ".target"),
    (r"\btarget, source\b", "source, target"),
    (r"1e3 \*|1000\.0 \*", ""),
)
# Loaded once; each test run starts from here.
LIBRARIES = ("numpy", "scipy.spatial", "scipy.optimize", "pydantic", "small_gicp", "rerun.chunk", "rosbags.highlevel")
LIBRARIES += ("mcap_protobuf.schema", "mcap_ros2.decoder", "jinja2", "jsonschema", "PIL.Image", "rich.table")
LOADED_EARLY = "ignore::pytest.PytestAssertRewriteWarning"


@dataclass(frozen=True)
class Mutant:
    """A changed line of a module, with the whole text of the changed module."""

    module: str
    line: int
    before: str
    after: str
    text: str


Change = str | tuple[object, int]
"""The whole changed text, or an operator with the number of its place."""


class _Sites(Visitor):
    def __init__(self, operator: object) -> None:
        self.operator = operator
        self.lines: list[int] = []

    def visit(self, node: object) -> object:
        self.lines += [start[0] for start, _ in self.operator.mutation_positions(node)]
        return node


def mutants_of(module: str, count: int) -> Iterator[Mutant]:
    """Choose lines at random, and one change of each that makes another program."""
    source = (ROOT / module).read_text(encoding="utf-8")
    changes, lines = _changes_by_line(source), source.splitlines()
    chance = random.Random(f"{SEED} {module}")  # noqa: S311
    order = sorted(changes)
    chance.shuffle(order)
    texts = (_changed(source, chance.choice(changes[line])) for line in order)
    others = (text for text in texts if _program(text) not in ("", _program(source)))
    for text in islice(others, count):
        pairs = zip(lines, text.splitlines(), strict=False)
        index, before, after = next((at, *pair) for at, pair in enumerate(pairs) if len({*pair}) > 1)
        yield Mutant(module, index + 1, before.strip(), after.strip(), text)


def _changes_by_line(source: str) -> dict[int, list[Change]]:
    changes: dict[int, list[Change]] = {}
    tree = get_ast(source)
    for name in plugins.operator_names():
        if re.match(f"core/({OPERATORS})", name):
            operator = plugins.get_operator(name)()
            sites = _Sites(operator)
            sites.walk(tree)
            for occurrence, line in enumerate(sites.lines):
                changes.setdefault(line, []).append((operator, occurrence))
    lines = source.splitlines(keepends=True)
    for index, line in enumerate(lines):
        for pattern, other in CONFUSIONS:
            found = re.sub(pattern, other, line, count=1)
            if found != line:
                # As likely as the operators of one place.
                text = "".join([*lines[:index], found, *lines[index + 1 :]])
                changes.setdefault(index + 1, []).extend([text] * 3)
    return changes


def _changed(source: str, change: Change) -> str:
    return change if isinstance(change, str) else mutate_code(source, *change) or ""


def _program(text: str) -> str:
    """Return the syntax tree without what changes no result, or none that is promised; "" if broken."""
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return ""
    return ast.dump(_Results().visit(tree))


class _Results(ast.NodeTransformer):
    """Leaves out annotations, the imports for them, and what only guards values: `slots`, `strict`, `frozen`.

    Also by how much a named number is above 9, as mutants change numbers by 1, and no test should pin a limit to a
    tenth of its size; and the alphabet, as nobody writes an order of texts where equality is meant.
    """

    def visit(self, node: ast.AST) -> ast.AST:
        for name in ("annotation", "returns"):
            if isinstance(getattr(node, name, None), ast.expr):
                setattr(node, name, ast.Constant(None))
        return super().visit(node)

    def visit_Module(self, node: ast.Module) -> ast.AST:
        for value in (each.value for each in node.body if isinstance(each, ast.Assign)):
            for number in (value, *getattr(value, "elts", ())):
                if isinstance(number, ast.Constant) and isinstance(number.value, int | float):
                    number.value = min(number.value, 9)
        return self.generic_visit(node)

    def visit_arguments(self, node: ast.arguments) -> ast.AST:
        node.args = [*node.posonlyargs, *node.args, *node.kwonlyargs]
        node.defaults += filter(None, node.kw_defaults)
        node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        node.keywords = [each for each in node.keywords if each.arg not in ("eq", "slots", "strict", "frozen")]
        return self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST:
        if "TYPE_CHECKING" in ast.unparse(node.test):
            node.test = ast.Constant(None)
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        sides = (each.value for each in (node.left, *node.comparators) if isinstance(each, ast.Constant))
        if any(isinstance(side, str) for side in sides):
            same = {ast.Lt: ast.NotEq(), ast.Gt: ast.NotEq(), ast.LtE: ast.Eq(), ast.GtE: ast.Eq()}
            node.ops = [same.get(type(each), each) for each in node.ops]
        return self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        is_type = any(re.fullmatch(r"[A-Z][a-z]\w*", name) for name in names)
        if is_type and isinstance(node.value, ast.Subscript | ast.BinOp):
            node.value = ast.Constant(None)
        return self.generic_visit(node)


def tests_of(module: str) -> tuple[str, ...]:
    tests = next(tests for pattern, tests in TARGETS.items() if fnmatch(module, pattern))
    return tuple(each.format(name=Path(module).stem) for each in tests)


def passes(copy: Path, tests: tuple[str, ...], limit_s: float) -> bool:
    """Run tests of the copy in a child process that has the libraries; too long is a failure."""
    child = os.fork()
    if child == 0:
        os.setsid()
        os.chdir(copy)
        output = os.open(copy.parent / OUTPUT, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        sys.path[:0] = [str(copy), str(copy / "cli")]
        os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
        os._exit(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-W", LOADED_EARLY, *tests]))
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status == 0
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def excused() -> dict[tuple[str, str, str], str]:
    """Reasons why no test can notice a change, by module and line before and after."""
    known = tomllib.loads(SURVIVORS.read_text(encoding="utf-8"))["survivors"]
    return {(each["module"], each["before"], each["after"]): each["reason"] for each in known}


def copy_sources(copy: Path) -> None:
    """Copy what the tests read, without environments, caches and the runs of users."""
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "node_modules", "__pycache__", "recordings"))
    shutil.copytree(ROOT / "recordings" / "samples", copy / "recordings" / "samples")


def modules() -> list[str]:
    found = (path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "multilica").rglob("*.py")))
    return [name for name in found if not name.endswith("__init__.py") and any(fnmatch(name, one) for one in TARGETS)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("patterns", nargs="*", default=["*"], help="modules, for example 'multilica/stages/*'")
    parser.add_argument("--mutants", type=int, default=MUTANTS, help=f"per module; {MUTANTS} end within an hour")
    given = parser.parse_args()
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    for library in LIBRARIES:
        import_module(library)
    # Without the search for the smallest example of a failure.
    settings.register_profile("mutate", derandomize=True, database=None, phases=[Phase.explicit, Phase.generate])
    settings.load_profile("mutate")
    killed = total = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        copy_sources(copy)
        for module in modules():
            if any(fnmatch(module, pattern) for pattern in given.patterns):
                survivors, count = survivors_of(copy, module, given.mutants)
                killed, total = killed + count - len(survivors), total + count
    print(f"killed {killed} of {total} ({killed / max(1, total):.0%}); at least {LEAST_SHARE:.0%} expected")
    return 0 if killed >= LEAST_SHARE * total else 1


def survivors_of(copy: Path, module: str, count: int) -> tuple[list[Mutant], int]:
    """Print the mutants of a module that its tests do not notice; return them, and how many there are in all."""
    tests, known = tests_of(module), excused()
    limit_s = time_limit_s(copy, tests)
    mutants = [each for each in mutants_of(module, count) if (module, each.before, each.after) not in known]
    survivors = [each for each in mutants if survives(copy, each, tests, limit_s)]
    print(f"{module}: {len(mutants) - len(survivors)} of {len(mutants)} killed", flush=True)
    for each in survivors:
        print(f"  line {each.line}\n    - {each.before}\n    + {each.after}", flush=True)
    return survivors, len(mutants)


@cache
def time_limit_s(copy: Path, tests: tuple[str, ...]) -> float:
    """Run tests without a change, which they must pass."""
    start = time.monotonic()
    if not passes(copy, tests, 600.0):
        sys.exit(f"{(copy.parent / OUTPUT).read_text()}\nthe tests fail without a change: {' '.join(tests)}")
    return 10.0 + 3.0 * (time.monotonic() - start)


def survives(copy: Path, mutant: Mutant, tests: tuple[str, ...], limit_s: float) -> bool:
    path = copy / mutant.module
    source = path.read_text(encoding="utf-8")
    path.write_text(mutant.text, encoding="utf-8")
    try:
        return passes(copy, tests, limit_s)
    finally:
        path.write_text(source, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
