# SPDX-License-Identifier: Apache-2.0
"""Plugin of pytest that keeps `make check` short: a test that takes long carries the mark `slow`.

CPU time counts, of all threads and of the processes that a test waited for: a test that waits for a busy machine does
not fail. A test is quick below half a second, and fails at four times that without the mark: a busy machine costs up to
twice the CPU time, and the first test of a process imports what it needs. Shared fixtures count by themselves.
"""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

QUICK_S = 0.5


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fail-slow", type=float, metavar="S", help="fail tests above so much CPU time without a mark")
    parser.addoption("--cpu-times", type=Path, metavar="FILE", help="write the CPU time of each test")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"slow: takes more than {QUICK_S} s of CPU time; `make check` leaves it out")
    config.pluginmanager.register(CpuTimes(config.option.fail_slow, config.option.cpu_times), "cpu-times")


def cpu_s() -> float:
    """CPU time of this process and of those that it waited for."""
    used = (resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


class CpuTimes:
    """Measures each test and each shared fixture."""

    def __init__(self, limit_s: float | None, table: Path | None) -> None:
        self._limit_s = limit_s
        self._table = table
        self._start_s = 0.0
        self._shared_s: dict[str, float] = {}
        self._in_shared = False
        self._lines: list[tuple[float, str]] = []

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Iterator[None]:
        self._start_s, self._shared_s = cpu_s(), {}
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[object]:
        if fixturedef.scope == "function" or self._in_shared:
            return (yield)
        self._in_shared, start_s = True, cpu_s()
        try:
            return (yield)
        finally:
            self._in_shared = False
            self._shared_s[f"the fixture {fixturedef.argname}"] = cpu_s() - start_s

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo) -> Iterator[pytest.TestReport]:
        report = yield
        if call.when == "call":
            own_s = cpu_s() - self._start_s - sum(self._shared_s.values())
            report.cpu_times = {"the test": own_s, **self._shared_s}
            if self._limit_s is not None and report.passed and item.get_closest_marker("slow") is None:
                slow = [
                    f"{name} takes {spent:.2f} s" for name, spent in report.cpu_times.items() if spent > self._limit_s
                ]
                if slow:
                    report.outcome = "failed"
                    report.longrepr = (
                        f"{', '.join(slow)} of CPU time: make it quicker, or mark it with pytest.mark.slow"
                    )
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, spent in getattr(report, "cpu_times", {}).items():
            self._lines.append((spent, f"{report.nodeid} {name}"))

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self._table is not None and not hasattr(session.config, "workerinput"):
            lines = (f"{spent:.3f} {name}\n" for spent, name in sorted(self._lines, reverse=True))
            self._table.write_text("".join(lines), encoding="utf-8")
