# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.fleet.support.made_store import NOMINAL, made_store


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "store"
    made_store(folder)
    return folder


@pytest.mark.slow
def test_the_page_lies_in_the_working_directory(store, invoke: Invoke):
    outcome = invoke("fleet", "report", "--store", store)
    assert (outcome.code, outcome.out) == (ExitCode.DONE, "wrote fleet-report.html\n")
    assert "1 LiDAR moved on 1 of 3 vehicles." in Path("fleet-report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_page_in_the_store_links_its_recordings(store, invoke: Invoke):
    outcome = invoke("fleet", "report", "--store", store, "--out", store / "report.html", "--quiet")
    assert (outcome.code, outcome.out) == (ExitCode.DONE, "")
    assert 'href="./runs/v02/' in (store / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_nominal_poses_come_from_a_file(store, invoke: Invoke):
    xyz_m, rpy_deg = NOMINAL["front"]
    pose = RigidTransform.from_xyz_rpy("top", "front", np.add(xyz_m, (0.0, 0.0, 1.0)), np.deg2rad(rpy_deg))
    Path("design.toml").write_text(tomli_w.dumps(extrinsics_table(Extrinsics("top", {"front": pose}))))
    given = ("--nominal", "design.toml", "--out", "new/folder/fleet-report.html")
    assert invoke("fleet", "report", "--store", store, *given).code == ExitCode.DONE
    assert "1 LiDAR sits elsewhere than designed." in Path("new/folder/fleet-report.html").read_text(encoding="utf-8")
    assert_one_sentence(invoke("fleet", "report", "--store", store, "--nominal", "none.toml"), ExitCode.INPUT)


@pytest.mark.parametrize("address", ["s3://bucket/report.html", "https://example.com/report.html"])
def test_an_address_is_no_place_for_a_page(address, store, invoke: Invoke):
    outcome = invoke("fleet", "report", "--store", store, "--out", address)
    assert outcome.code == ExitCode.USAGE
    assert "--out" in outcome.err


def test_without_a_store_there_is_no_page(invoke: Invoke):
    assert invoke("fleet", "report", "--store", "none").code == ExitCode.INPUT
    assert not Path("fleet-report.html").exists()
