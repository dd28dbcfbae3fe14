# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
import tomli_w

from multilica_cli.commands.calibrate import find_sample
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, Outcome, assert_one_sentence
from tests.sinks.made_documents import made_document


@pytest.fixture
def result(tmp_path: Path) -> Path:
    path = tmp_path / "run" / "result.json"
    path.parent.mkdir()
    path.write_text(json.dumps(made_document("complete")))
    return path


def truth_with(path: Path, lidar: str = "", shift_m: float = 0.0) -> Path:
    """The sample's truth, with one LiDAR shifted along x."""
    values = tomllib.loads(find_sample().truth.read_text())
    for name, entry in values["lidars"].items():
        entry.pop("T_target_source", None)
        entry.pop("quaternion_xyzw", None)
        entry["xyz_m"][0] += shift_m if name == lidar else 0.0
    path.write_text(tomli_w.dumps(values))
    return path


def test_a_run_agrees_with_itself(invoke: Invoke, result: Path) -> None:
    for source in (result, result.parent):
        outcome = invoke("check", source, "--against", result)
        assert (outcome.code, outcome.err) == (ExitCode.DONE, "")
        assert "All 3 LiDARs agree with the reference." in outcome.out


def test_a_reference_elsewhere_is_outside(invoke: Invoke, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = made_document("complete")
    document["lidars"]["rear"]["T_target_source"][2][3] += 0.1
    reference = result.with_name("reference.json")
    reference.write_text(json.dumps(document))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(result.with_name("step.md")))
    reports = "--junit", "j.xml", "--summary", "s.md", "--code-quality", "q.json"
    outcome = invoke("check", result, "--against", reference, *reports)
    assert outcome.code == ExitCode.DIFFERENT
    assert "rear is outside." in outcome.out
    assert "::error title=rear is outside::" in outcome.out
    assert all(Path(name).stat().st_size for name in ("j.xml", "s.md", "s.md.png", "q.json"))
    assert "rear is outside" in result.with_name("step.md").read_text()
    assert invoke("check", result, "--against", reference, "--max-translation", "0.2").code == ExitCode.DONE
    document = json.loads(invoke("check", result, "--against", reference, "--json").out)
    assert document["rigs"][0]["moved"] == ["rear"]
    assert document["rigs"][0]["lidars"]["rear"]["distance_m"] == pytest.approx(0.1, abs=1e-9)


def test_what_is_not_placed_is_undecided(invoke: Invoke, result: Path) -> None:
    partial = result.with_name("partial.json")
    partial.write_text(json.dumps(made_document("partial")))
    outcome = invoke("check", partial, "--against", result)
    assert outcome.code == ExitCode.NOT_PLACED
    assert "rear: not placed" in outcome.out


def without_rear(result: Path, **changes: object) -> Path:
    """The run as if its recording had no topic of the rear LiDAR; it has a note of the reader."""
    document = made_document("complete")
    for part in (document["lidars"], document["input"]["lidars"], document["stages"]["preprocess"]):
        part.pop("rear", None)
    document["pairs"] = [pair for pair in document["pairs"] if "rear" not in (pair["target"], pair["source"])]
    document["stages"], document["refinement"], document["decisions"] = None, None, []
    document["input"]["notes"] = ["5 of 10 scans, then the file ends too early"]
    document["config"]["ingest"] |= changes
    path = result.with_name("without.json")
    path.write_text(json.dumps(document))
    return path


def test_a_lidar_that_the_recording_lacks_is_undecided(invoke: Invoke, result: Path, tmp_path: Path) -> None:
    tolerances = tmp_path / "t.toml"
    tolerances.write_text("[lidars.rear]\ntranslation_m = 0.07\n")
    run = without_rear(result)
    outcome = invoke("check", run, "--against", result, "--tolerances", tolerances, "--json")
    assert outcome.code == ExitCode.NOT_PLACED, outcome.err
    (rig,) = json.loads(outcome.out)["rigs"]
    assert rig["lidars"]["rear"]["verdict"] == "undecided"
    assert rig["lidars"]["rear"]["max_translation_m"] == 0.07
    assert "no scan of that LiDAR was read" in rig["lidars"]["rear"]["reason"]
    assert "5 of 10 scans, then the file ends too early" in rig["notes"]
    assert "note: 5 of 10 scans" in invoke("check", run, "--against", result).out


@pytest.mark.parametrize("chosen", [{"topics": {"top": "/top", "front left/1": "/front"}}, {"only": ["/[tf]*"]}])
def test_lidars_that_chosen_topics_leave_out_are_noted(invoke: Invoke, result: Path, chosen: dict[str, object]) -> None:
    run = without_rear(result, **chosen)
    outcome = invoke("check", run, "--against", result)
    assert outcome.code == ExitCode.DONE, outcome.err
    assert "note: the reference has rear, which the chosen topics leave out" in outcome.out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--set", "bogus.key=1"], "--set is for recordings"),
        (["--stops", "2"], "--stops is for recordings"),
        (["--max-rotation", "200"], "Found --max-rotation 200; expected at most 180 degrees."),
        (["--max-translation", "inf"], "Found --max-translation inf; expected at most 100 m."),
    ],
)
def test_options_that_a_run_cannot_have_are_refused(
    invoke: Invoke, result: Path, options: list[str], said: str
) -> None:
    outcome = invoke("check", result, "--against", result, *options)
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert said in outcome.err


def test_bad_references_are_refused(invoke: Invoke, result: Path, tmp_path: Path) -> None:
    assert_one_sentence(invoke("check", result, "--against", "nowhere.toml"), ExitCode.INPUT)
    broken = tmp_path / "broken.toml"
    broken.write_text("schema = 3")
    assert_one_sentence(invoke("check", result, "--against", broken), ExitCode.INPUT)
    others = truth_with(tmp_path / "others.toml")
    others.write_text(others.read_text().replace("lidars.", "lidars.other_"))
    assert_one_sentence(invoke("check", result, "--against", others), ExitCode.USAGE)
    assert_one_sentence(invoke("check", result, "log.mcap", "--against", result), ExitCode.USAGE)
    assert_one_sentence(invoke("check", result, "--against", result, "--tolerances", "none.toml"), ExitCode.INPUT)
    assert_one_sentence(invoke("verify", "nowhere.mcap", "--calibration", result), ExitCode.INPUT)
    recording = find_sample().recording
    outcome = invoke("check", recording, "--against", broken, "--out", tmp_path / "new")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_verify_names_the_lidar_that_moved(invoke: Invoke, tmp_path: Path) -> None:
    sample = find_sample().recording
    right = invoke("verify", sample, "--calibration", truth_with(tmp_path / "truth.toml"))
    assert (right.code, right.err) == (ExitCode.DONE, "")
    moved = invoke("verify", sample, "--calibration", truth_with(tmp_path / "moved.toml", "right", 0.05), "--json")
    assert moved.code == ExitCode.DIFFERENT
    (rig,) = json.loads(moved.out)["rigs"]
    assert rig["moved"] == ["right"]
    assert rig["lidars"]["right"]["distance_m"] == pytest.approx(0.05, abs=0.003)


@pytest.mark.slow
@pytest.mark.in_turn
def test_verify_tells_of_a_lidar_far_away(invoke: Invoke, tmp_path: Path) -> None:
    moved = truth_with(tmp_path / "moved.toml", "front", 4.0)
    outcome = invoke("verify", find_sample().recording, "--calibration", moved)
    assert outcome.code == ExitCode.DIFFERENT
    assert "front: its beams contradict the known pose" in outcome.out


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_recording_is_calibrated_before_it_is_checked(invoke: Invoke, two_lidars: Path, tmp_path: Path) -> None:
    truth = truth_with(tmp_path / "truth.toml", "left", 0.5)
    outcome = invoke("check", two_lidars, "--against", truth, "--out", "run", "--workers", "1", "--quiet")
    assert outcome.code == ExitCode.DIFFERENT
    assert "so the one that moved is unknown" in invoke("check", "run", "--against", truth).out


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_reviewed_run_becomes_the_reference(invoke: Invoke, two_lidars: Path) -> None:
    options = "--workers", "1", "--quiet", "--target", "left"
    assert invoke("calibrate", two_lidars, "--out", "run", *options).code == ExitCode.DONE
    first = invoke("accept", "run", "--into", "calibration.toml")
    assert (first.code, first.out) == (ExitCode.DONE, "wrote calibration.toml\n")
    accepted = Path("calibration.toml").read_text()
    assert accepted == Path("run/calibration.toml").read_text()
    assert tomllib.loads(accepted)["input"]["sha256"]
    assert invoke("check", "run", "--against", "calibration.toml").code == ExitCode.DONE
    assert "All 2 LiDARs agree" in invoke("accept", "run", "--into", "calibration.toml").out
    assert invoke("accept", "run", "--into", "new/folder/calibration.toml").code == ExitCode.DONE
    assert invoke("calibrate", two_lidars, "--out", "other", *options[:-1], "right").code == ExitCode.DONE
    refused = invoke("accept", "other", "--into", "calibration.toml")
    assert_one_sentence(refused, ExitCode.INPUT)
    assert "calibrate with --target left" in refused.err
    assert Path("calibration.toml").read_text() == accepted


def test_a_run_that_places_too_little_is_not_accepted(invoke: Invoke, result: Path) -> None:
    result.write_text(json.dumps(made_document("partial")))
    result.with_name("calibration.toml").write_text("")
    outcome = invoke("accept", result.parent, "--into", "calibration.toml")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "does not place rear" in outcome.err
    assert not Path("calibration.toml").exists()


def test_a_pose_from_before_a_knock_is_no_reference(invoke: Invoke, result: Path) -> None:
    document = made_document("complete")
    knock = {"lidar": "rear", "before": "stop 3", "after": "stop 4", "distance_m": 0.2, "angle_deg": 3.0}
    result.write_text(json.dumps(document | {"knocks": [knock | {"left_out": ["stop 4"]}]}))
    result.with_name("calibration.toml").write_text("")
    outcome = invoke("accept", result.parent, "--into", "calibration.toml")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert "rear before it moved: rear moved by 200 mm, 3.00 deg between stop 3 and stop 4" in outcome.err
    assert invoke("check", result, "--against", result).code == ExitCode.DIFFERENT


@pytest.mark.parametrize(("outvoted", "code"), [("monday", ExitCode.DONE), ("tuesday", ExitCode.INPUT)])
def test_poses_the_last_snapshot_contradicts_are_no_reference(
    invoke: Invoke, result: Path, outvoted: str, code: ExitCode
) -> None:
    off = {"lidar": "rear", "distance_m": 0.08, "angle_deg": 0.5, "outlier": True}
    snapshots = [
        {"name": name, "source": "", "sha256": "", "refusal": None, "outliers": [], "disputed": [], "deviations": []}
        | ({"outliers": ["rear"], "deviations": [off]} if name == outvoted else {})
        for name in ("monday", "tuesday")
    ]
    result.write_text(json.dumps(made_document("complete") | {"snapshots": snapshots}))
    truth_with(result.with_name("calibration.toml"))
    outcome = invoke("accept", result.parent, "--into", "calibration.toml")
    assert outcome.code == code
    if code:
        assert_one_sentence(outcome, code)
        assert "(tuesday: OUTLIER: rear is off by 80.0 mm" in outcome.err
    told = invoke("check", result, "--against", result).out
    assert f"{outvoted}: OUTLIER: rear is off by 80.0 mm, 0.500 deg from the other snapshots" in told


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_check_ends_in_time_with_what_is_undecided(invoke: Invoke, two_lidars: Path, tmp_path: Path) -> None:
    truth = truth_with(tmp_path / "truth.toml")
    for command in (
        ("verify", find_sample().recording, "--calibration", truth),
        ("check", two_lidars, "--against", truth, "--out", "run", "--workers", "1"),
    ):
        outcome = invoke(*command, "--max-time", "0.001", "--json")
        assert outcome.code == ExitCode.NOT_PLACED
        (rig,) = json.loads(outcome.out)["rigs"]
        assert {each["verdict"] for each in rig["lidars"].values()} == {"undecided"}
        reasons = [
            each["reason"] for each in rig["lidars"].values() if "no scan of that LiDAR was read" not in each["reason"]
        ]
        assert reasons
        assert all("the time limit (--max-time)" in each for each in reasons)
    assert_one_sentence(invoke(*command, "--max-time", "-1"), ExitCode.USAGE)


@pytest.mark.parametrize("option", ["--junit", "--summary", "--code-quality"])
@pytest.mark.parametrize("command", ["check", "verify"])
def test_a_report_that_cannot_be_written_ends_it_first(
    invoke: Invoke, result: Path, tmp_path: Path, command: str, option: str
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    reference = "--against" if command == "check" else "--calibration"
    for path, told in (("file/report", "file"), ("folder", "folder")):
        outcome = invoke(command, "nowhere.mcap", reference, result, option, path)
        assert_one_sentence(outcome, ExitCode.BROKEN)
        assert f"({told})" in outcome.err


def test_a_watch_refuses_a_tolerance_of_no_lidar(invoke: Invoke, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multilica.watch.watch_vehicle", lambda *_: None)
    name = next(iter(json.loads(result.read_text())["lidars"]))

    def watched(lidar: str, *options: str) -> Outcome:
        Path("limits.toml").write_text(f'[lidars."{lidar}"]\ntranslation_m = 0.1\n', encoding="utf-8")
        return invoke("watch", "ws://localhost:1", "--calibration", result, "--tolerances", "limits.toml", *options)

    outcome = watched("nose")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "There is a tolerance for 'nose', which " in outcome.err
    assert name in outcome.err
    assert watched(name).code == watched("nose", "--topic", "nose=/nose/points").code == ExitCode.DONE
