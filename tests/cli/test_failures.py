# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import signal

import pytest

from multilica.errors import InputError, MultilicaError, UnknownNameError, WorkerDiedError
from multilica_cli import main
from multilica_cli.exit_codes import ExitCode, describe_failure, print_failure
from multilica_cli.signals import Interrupted
from tests.cli.support import Invoke, assert_one_sentence


@pytest.mark.parametrize(
    ("failure", "code", "told"),
    [
        (UnknownNameError("preset", "x", ["default"]), ExitCode.USAGE, "no preset 'x'"),
        (InputError("It is empty."), ExitCode.INPUT, "It is empty."),
        (MultilicaError("It cannot be."), ExitCode.BROKEN, "It cannot be."),
        (WorkerDiedError("A worker process died."), ExitCode.BROKEN, "A worker process died."),
        (Interrupted(signal.SIGTERM), 143, "SIGTERM"),
        (Interrupted(signal.SIGINT), 130, "SIGINT"),
        (OSError(28, "No space left", "run/result.json"), ExitCode.BROKEN, "left (run/result.json); free some"),
        (ImportError("libGL.so.1: cannot open shared object file"), ExitCode.BROKEN, "multilica doctor"),
        (ModuleNotFoundError("No module named 'numpy'", name="numpy"), ExitCode.BROKEN, "is not installed (numpy)"),
        (ModuleNotFoundError("no multilica.x", name="multilica.x"), ExitCode.BROKEN, "bug in multilica"),
        (MemoryError(), ExitCode.BROKEN, "Out of memory"),
        (ImportError("lib.so: failed to map segment from shared object"), ExitCode.BROKEN, "ulimit -v"),
        (ValueError("no\nway"), ExitCode.BROKEN, "ValueError"),
        (ImportError("cannot import name 'x'"), ExitCode.BROKEN, "bug in multilica"),
        (BrokenPipeError(), ExitCode.BROKEN, ""),
    ],
)
def test_each_failure_has_its_code_and_sentence(failure: BaseException, code: int, told: str) -> None:
    found_code, sentence = describe_failure(failure)
    assert found_code == code
    assert told in sentence


def test_a_note_of_what_remains_is_part_of_the_sentence() -> None:
    interrupted = Interrupted(signal.SIGTERM)
    interrupted.add_note("The recording is in run.")
    assert describe_failure(interrupted)[1] == "Stopped by SIGTERM. The recording is in run."


def test_a_long_sentence_loses_its_middle(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_failure(InputError(f"The topic {'x' * 10_000} is empty; give another.")) == ExitCode.INPUT
    told = capsys.readouterr().err
    assert len(told) < 600
    assert told.startswith("multilica: The topic xxx")
    assert told.endswith("xxx is empty; give another.\n")


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **options: object) -> None:
        del arguments, options
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(main, "app", fail)


@pytest.mark.usefixtures("faulty")
def test_a_bug_is_one_line_without_traceback(invoke: Invoke) -> None:
    outcome = invoke("calibrate")
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "MULTILICA_DEBUG=1" in outcome.err


@pytest.mark.usefixtures("faulty")
def test_the_debug_variable_adds_the_traceback(invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTILICA_DEBUG", "1")
    outcome = invoke("calibrate")
    assert outcome.code == ExitCode.BROKEN
    assert "ZeroDivisionError: a" in outcome.err.split("Traceback")[1]
