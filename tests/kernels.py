# SPDX-License-Identifier: Apache-2.0
"""Runner of the tests whose results could depend on the CPU, with the kernels of three generations of CPUs.

OpenBLAS and NumPy choose kernels by the CPU, and other kernels round the last bits differently.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys

from tests.selection import ROOT, some_of


def half_of(folder: str, first: int) -> tuple[str, ...]:
    """Return every second file of a folder of tests."""
    files = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / folder).glob("test_*.py"))
    return tuple(files[first::2])


FOLDERS = ("tests/unit", "tests/property", "tests/pipeline", "tests/sinks")
# Of these a push runs one row, another each time, with the kernel that differs most from those of today's CPUs: the
# numbers, or what they decide.
NUMERIC = (
    *(half_of(f"tests/unit/{name}", first) for name in ("registration", "stages") for first in range(2)),
    (*(f"tests/unit/{name}" for name in ("acceptance", "solvers", "visibility")), "tests/property/test_geometry.py"),
    ("tests/pipeline/test_prior.py",),
    tuple(f"tests/pipeline/test_{name}.py" for name in ("real_scans", "simulated")),
)
PUSH_KERNEL = "Prescott"
# What no kernel changes: two runs of the same kernel, the stages that ran, and how often random errors are covered.
SAME_WITH_ANY_KERNEL = "not same_bits and not stopping_after_any_stage and not as_the_covariance_says"
# The rules of the house, and what is drawn by a viewer or a browser.
SAME_ON_ANY_CPU = (
    "tests/unit/project",
    "tests/sinks/rerun/test_headless_viewer.py",
    "tests/sinks/report/test_report_in_browser.py",
    "tests/sinks/mcap/test_foxglove_studio.py",
)
IGNORED = [f"--ignore={path}" for path in SAME_ON_ANY_CPU]
PYTEST = [sys.executable, "-m", "pytest", "-q", *IGNORED]
TWO_WORKERS = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]
VARIABLES = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES")
ALIASES = {"Katmai": "Prescott"}  # OpenBLAS has one kernel for both and reports the first name.

# What NumPy may use beside each kernel; before version 2.4 it has a name per extension, later one per generation.
AVX2 = {"X86_V3", "SSSE3", "SSE41", "POPCNT", "SSE42", "AVX", "F16C", "FMA3", "AVX2"}
ALLOWED = {"Haswell": AVX2, "SkylakeX": AVX2 | {"X86_V4", "AVX512F", "AVX512CD", "AVX512_SKX"}, "Prescott": set()}
NEEDED = {"Haswell": {"X86_V3", "AVX2"}, "SkylakeX": {"X86_V4", "AVX512_SKX"}, "Prescott": {"X86_V2", "SSE3"}}

PROBE = """
import json, numpy, scipy.linalg, threadpoolctl
scipy.linalg.svd(numpy.ones((9, 9)) @ numpy.eye(9))
copies = [copy["architecture"] for copy in threadpoolctl.threadpool_info() if copy["internal_api"] == "openblas"]
simd = numpy.show_config(mode="dicts")["SIMD Extensions"]
print(json.dumps([copies, simd["baseline"], simd.get("found", [])]))
"""


def probe(chosen: dict[str, str]) -> tuple[set[str], set[str], list[str]]:
    """Return the kernels of OpenBLAS in a new process, NumPy's baseline features, and the others that it found."""
    inherited = {key: value for key, value in os.environ.items() if key not in VARIABLES}
    command = [sys.executable, "-W", "error", "-c", PROBE]
    output = subprocess.run(command, env=inherited | chosen, check=True, stdout=subprocess.PIPE, text=True).stdout
    copies, baseline, found = json.loads(output)
    return {ALIASES.get(name, name) for name in copies}, set(baseline), found


def run_tests(kernel: str, arguments: list[str], *, beside_others: bool = False) -> str:
    """Run the tests with one kernel; return what came of it. Beside other tests, one process prints when it ended."""
    _, baseline, found = probe({})
    if not NEEDED[kernel] & {*baseline, *found}:
        return f"skipped: this CPU has none of {', '.join(sorted(NEEDED[kernel]))}"
    disabled = [feature for feature in found if feature not in ALLOWED[kernel]]
    chosen = dict(zip(VARIABLES, (kernel, " ".join(disabled)), strict=True))
    used, _, kept = probe(chosen)
    if not used:
        return "skipped: NumPy and SciPy use another library than OpenBLAS here"
    if used != {kernel} or {*kept} & {*disabled}:
        return f"failed: {chosen} is ignored: OpenBLAS uses {', '.join(sorted(used))}, NumPy {', '.join(kept)}"
    print(f"== {kernel}: NumPy without {' '.join(disabled) or '-'}", flush=True)
    output, workers = (subprocess.PIPE, []) if beside_others else (None, TWO_WORKERS)
    command = [*PYTEST, *workers, *arguments]
    ended = subprocess.run(command, env=os.environ | chosen, stdout=output, text=True, check=False)
    print(ended.stdout or "", end="", flush=True)
    return f"failed: pytest ended with {ended.returncode}" if ended.returncode else "passed"


def main() -> int:
    """Run the tests with each kernel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--push", action="store_true", help=f"only {PUSH_KERNEL}, and only tests of numbers")
    given, others = parser.parse_known_args()
    of_push = (*some_of(NUMERIC, 1)[0], "-k", SAME_WITH_ANY_KERNEL)
    kernels, folders = ([PUSH_KERNEL], of_push) if given.push else (ALLOWED, FOLDERS)
    outcomes = {kernel: run_tests(kernel, [*folders, *others], beside_others=given.push) for kernel in kernels}
    print("", *(f"{kernel}: {outcome}" for kernel, outcome in outcomes.items()), sep="\n")
    return int(any(outcome.startswith("failed") for outcome in outcomes.values()))


if __name__ == "__main__":
    sys.exit(main())
