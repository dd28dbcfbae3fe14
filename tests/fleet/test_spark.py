# SPDX-License-Identifier: Apache-2.0
"""Spark reads the tables: needs `pip install pyspark` and a Java, which take too long to install for each push."""

import shutil

import numpy as np
import pytest

from multilica.fleet.store.query import ask
from tests.fleet.support.made_store import COVARIANCE, made_store

pyspark = pytest.importorskip("pyspark", reason="pyspark is not installed")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("java") is None, reason="Spark needs a Java"),
    pytest.mark.filterwarnings("ignore"),
]


@pytest.fixture(scope="module")
def spark(tmp_path_factory):
    from pyspark.sql import SparkSession

    settings = {
        "spark.ui.enabled": "false",
        "spark.driver.bindAddress": "127.0.0.1",
        "spark.driver.host": "127.0.0.1",
        "spark.sql.session.timeZone": "UTC",
        "spark.sql.warehouse.dir": str(tmp_path_factory.mktemp("warehouse")),
    }
    builder = SparkSession.builder.master("local[1]")
    for name, value in settings.items():
        builder = builder.config(name, value)
    session = builder.getOrCreate()
    yield session
    session.stop()


def test_spark_reads_partitions_and_covariances(spark, tmp_path):
    store = made_store(tmp_path / "store", vehicles=2, logs=3)
    for name in ("lidars", "logs"):
        table = spark.read.parquet(f"{store.root}/{name}")
        assert {"vehicle", "month", "key"} <= {*table.columns}
        found = sorted((row.vehicle, row.month, row.key) for row in table.select("vehicle", "month", "key").collect())
        with ask(store, f"SELECT vehicle, month, key FROM {name}") as answer:  # noqa: S608
            assert found == sorted(answer.rows())
    rows = spark.read.parquet(f"{store.root}/lidars").where("vehicle = 'v01' AND lidar = 'front'").collect()
    assert len(rows) == 3
    for row in rows:
        assert len(row.covariance) == 36
        np.testing.assert_array_equal(row.covariance, COVARIANCE)
        assert abs(row.x_m - 2.0) < 0.1
        assert row.month == f"{row.time:%Y-%m}"
