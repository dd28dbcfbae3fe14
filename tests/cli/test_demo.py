# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from multilica import read_extrinsics
from multilica_cli.commands import calibrate as sample_module
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import Invoke, assert_one_sentence

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_sample_is_calibrated_beside_its_truth(invoke: Invoke) -> None:
    outcome = invoke("demo", "--out", "run")
    assert outcome.code == 0
    errors = [line.split()[-2:] for line in outcome.out.splitlines() if line.split()[:1] == ["true"]]
    assert len(errors) == 3
    assert all(float(millimetres) < 20.0 and float(degrees) < 0.1 for millimetres, degrees in errors)
    assert "wrote run/recording.rrd" in outcome.out
    with Path("run/result.mcap").open("rb") as file:
        attached = {one.name: one.data.decode() for one in make_reader(file).iter_attachments()}
    assert attached["foxglove-layout.json"] == (ROOT / "docs" / "reference" / "foxglove-layout.json").read_text(
        encoding="utf-8"
    )
    result = json.loads(Path("run/result.json").read_text(encoding="utf-8"))
    truth = read_extrinsics(find_sample().truth)
    for name, entry in result["lidars"].items():
        assert entry["xyz_m"] == pytest.approx(truth.between(result["target"], name).xyz_m, abs=0.02)


def test_the_sample_is_small() -> None:
    assert find_sample().recording.stat().st_size < 2_000_000


def test_a_missing_sample_is_told(invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample_module, "SAMPLE_NAME", "nothing")
    assert_one_sentence(invoke("demo", "--out", "run"), 1)
    assert not Path("run").exists()
