# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest
from pyarrow import parquet

from multilica.errors import UsageError
from multilica.runs import Evaluation, Truth, evaluate, read_run
from multilica.runs.evaluation import write_table
from tests.runs.made_runs import made_truth, write_run


@pytest.fixture
def evaluation(tmp_path: Path) -> Evaluation:
    run = write_run(tmp_path / "run", {"left": ((0.003, 0, 0), (0, 0, 0.05)), "rear": None}, sigmas=(0.05, 0.003))
    return evaluate([read_run(run)], [Truth("truth", made_truth())])


def test_parquet_holds_every_row(evaluation: Evaluation, tmp_path: Path) -> None:
    write_table(evaluation, tmp_path / "deep" / "table.parquet")
    table = parquet.read_table(tmp_path / "deep" / "table.parquet")
    assert table.to_pylist() == [one.model_dump() for one in evaluation.lidars]
    assert table["error_yaw_deg"].to_pylist() == [pytest.approx(0.05), None]
    assert table["error_normalised"].to_pylist() == [pytest.approx(math.sqrt(2.0 / 6.0)), None]
    assert table["error_sigma"].to_pylist() == [pytest.approx(0.1008, abs=0.001), None]
    assert str(table.schema.field("placed").type) == "bool"
    about = json.loads(table.schema.metadata[b"multilica"])
    assert about["schema"] == "multilica/evaluation/1"
    assert about["overall"]["false_refuse"] == 1


def test_csv_holds_every_row(evaluation: Evaluation, tmp_path: Path) -> None:
    write_table(evaluation, tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        left, rear = csv.DictReader(file)
    assert float(left["error_x_m"]) == pytest.approx(0.003)
    assert float(left["error_sigma"]) == pytest.approx(0.1008, abs=0.001)
    assert rear["error_sigma"] == ""
    assert (left["outcome"], rear["outcome"], rear["error_x_m"]) == ("within", "false_refuse", "")


@pytest.mark.parametrize("name", ["table.parquet", "table.csv"])
def test_a_failed_write_leaves_the_old_table(
    name: str, evaluation: Evaluation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / name).write_text("old", encoding="utf-8")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.parquet.write_table", fail)
    monkeypatch.setattr("csv.DictWriter.writerows", fail)
    with pytest.raises(OSError, match="No space"):
        write_table(evaluation, tmp_path / name)
    assert (tmp_path / name).read_text(encoding="utf-8") == "old"
    assert not list(tmp_path.glob(".*"))


def test_another_suffix_is_refused(evaluation: Evaluation, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.parquet or \.csv"):
        write_table(evaluation, tmp_path / "table.xlsx")
