# SPDX-License-Identifier: Apache-2.0
"""The recipes for CI services, with their steps run as the service would run them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
import yaml

from multilica import system_libraries
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import write_thinned_sample
from tests.selection import some_of
from tests.sinks.made_documents import made_document

ROOT = Path(__file__).parents[2]
PIPELINES = ROOT / "docs" / "pipelines"


def github_job() -> list[dict[str, Any]]:
    return yaml.safe_load((PIPELINES / "github.yml").read_text())["jobs"]["check"]["steps"]


def github_steps() -> list[str]:
    return [step["run"] for step in github_job() if "run" in step]


def gitlab_steps() -> list[str]:
    job = yaml.safe_load((PIPELINES / "gitlab.yml").read_text())["extrinsics"]
    return [*job["before_script"], *job["script"]]


def jenkins_steps() -> list[str]:
    return re.findall(r"sh '([^']+)'", (PIPELINES / "Jenkinsfile").read_text())


RECIPES = {github_steps: "github.yml", gitlab_steps: "gitlab.yml", jenkins_steps: "Jenkinsfile"}


def action_steps() -> tuple[list[str], dict[str, str]]:
    """The steps of the composite action, and the environment that its inputs' defaults give."""
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    steps = action["runs"]["steps"]
    values = {name: each.get("default", "recordings/*.mcap") for name, each in action["inputs"].items()}
    environment = {}
    for step in steps:
        for name, text in step.get("env", {}).items():
            key = re.fullmatch(r"\$\{\{ (inputs|github)\.([\w-]+) \}\}", text)
            environment[name] = values.get(key[2], "/action")
    return [step["run"] for step in steps], environment


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A checkout with a recording, its extrinsics, and programs of the service that only note their calls."""
    for name in ("recordings", "bin"):
        (tmp_path / name).mkdir()
    write_thinned_sample(tmp_path / "recordings" / "drive.mcap", 6)
    shutil.copy(find_sample().truth, tmp_path / "calibration.toml")
    git(tmp_path, "init", "--quiet", "--bare", "origin.git")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "remote", "add", "origin", "origin.git")
    for name in ("pip", "gh"):
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\necho "{name} $*" >> "{tmp_path}/calls.txt"\n')
        program.chmod(0o755)
    program = tmp_path / "bin" / "multilica"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m multilica_cli "$@"\n')
    program.chmod(0o755)
    return tmp_path


def git(folder: Path, *words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=folder, capture_output=True, check=True).stdout


def run(project: Path, steps: list[str], **variables: str) -> int:
    """Run steps as `bash -e` does, and return the first exit code that is not 0."""
    path = f"{project / 'bin'}{os.pathsep}{os.environ['PATH']}"
    python = f"{ROOT}{os.pathsep}{ROOT / 'cli'}"
    service = {"NUMBER": "7", "GITHUB_SERVER_URL": "https://github.com", "GITHUB_REPOSITORY": "o/r"}
    environment = {**os.environ, "PATH": path, "PYTHONPATH": python, **service, **variables}
    for step in steps:
        shown = re.sub(r"\$\{\{[^}]+\}\}", "7", step)
        command = ["bash", "-e", "-o", "pipefail", "-c", shown]
        outcome = subprocess.run(command, cwd=project, env=environment, check=False)
        if outcome.returncode:
            return outcome.returncode
    return 0


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("steps", some_of(RECIPES, 1, lambda steps: f"docs/pipelines/{RECIPES[steps]}"))
def test_each_recipe_passes_and_leaves_its_artifacts(project, steps):
    assert run(project, steps()) == 0
    left = {path.name for path in (project / "artifacts").iterdir()}
    assert {"run", "check.xml", "check.md", "check.md.png"} <= left
    assert (project / "artifacts" / "run" / "recording.rrd").exists()
    assert "pip install multilica" in (project / "calls.txt").read_text()
    if steps is github_steps:
        assert "gh pr comment 7 --body-file artifacts/comment.md" in (project / "calls.txt").read_text()


def run_github(project: Path, *, fork: bool = False) -> tuple[int, list[str]]:
    """Run the job of GitHub Actions, and return its exit code and the names of the steps that ran."""
    failed, ran = 0, []
    for step in github_job():
        holds = {
            "always()": True,
            "hashFiles('artifacts/check.md') != ''": (project / "artifacts" / "check.md").exists(),
            "github.event.pull_request.head.repo.full_name == github.repository": not fork,
        }
        clauses = step.get("if", "").split(" && ") if "if" in step else []
        if not all(holds[each] for each in clauses) or (failed and "always()" not in clauses):
            continue
        ran.append(step.get("name") or step.get("uses") or step["run"])
        code = run(project, [step["run"]], GITHUB_STEP_SUMMARY=f"{project}/page.md") if "run" in step else 0
        failed = failed or (0 if step.get("continue-on-error") else code)
    return failed, ran


@pytest.fixture
def checked(project: Path) -> Path:
    """The project, where the check of its recording is that of a run which agrees."""
    run_of = project / "recordings" / "run"
    run_of.mkdir()
    (run_of / "result.json").write_text(json.dumps(made_document("complete")))
    check = f'"{sys.executable}" -m multilica_cli check recordings/run --against'
    script = f'#!/bin/sh\nshift 4\nexec {check} "${{REFERENCE-recordings/run}}" "$@"\n'
    (project / "bin" / "multilica").write_text(script)
    return project


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_picture_in_the_comment_is_at_an_address(checked):
    code, ran = run_github(checked)
    assert (code, "Comment" in ran) == (0, True)
    shown = re.findall(r"!\[[^]]*\]\(([^)]*)\)", (checked / "artifacts" / "comment.md").read_text())
    (commit,) = {re.fullmatch(r"https://github\.com/o/r/raw/(\w{40})/check\.png", each)[1] for each in shown}
    assert git(checked / "origin.git", "rev-parse", "refs/extrinsics/7").decode().strip() == commit
    assert git(checked / "origin.git", "show", f"{commit}:check.png").startswith(b"\x89PNG")
    assert git(checked / "origin.git", "branch").strip() == b""
    assert run_github(checked)[0] == 0  # a second push to the pull request


@pytest.mark.in_turn
def test_a_pull_request_from_a_fork_has_summary_and_artifact(checked):
    code, ran = run_github(checked, fork=True)
    assert code == 0
    assert "Comment" not in ran
    assert "upload-artifact" in ran[-1]
    assert "## LiDAR extrinsics: within" in (checked / "page.md").read_text()
    assert "gh" not in (checked / "calls.txt").read_text().split()


@pytest.mark.in_turn
@pytest.mark.parametrize("broken", ["gh", "push"])
def test_a_comment_that_is_refused_does_not_fail_the_job(checked, broken):
    if broken == "push":
        shutil.rmtree(checked / "origin.git")
    else:
        (checked / "bin" / "gh").write_text("#!/bin/sh\nexit 1\n")
    code, ran = run_github(checked)
    assert code == 0
    assert "upload-artifact" in ran[-1]


def test_a_lidar_that_moved_is_commented_on_and_fails_the_job(checked, monkeypatch):
    moved = made_document("complete")
    moved["lidars"]["rear"]["T_target_source"][2][3] += 0.1
    (checked / "moved.json").write_text(json.dumps(moved))
    monkeypatch.setenv("REFERENCE", "moved.json")
    code, ran = run_github(checked)
    assert code == 5
    assert "Comment" in ran
    assert "OUTSIDE" in (checked / "artifacts" / "comment.md").read_text()


def test_actions_and_images_have_a_version():
    """A version has three numbers: a tag with fewer is another image tomorrow."""
    images = PIPELINES / "gitlab.yml", PIPELINES / "Jenkinsfile", ROOT / "Dockerfile"
    named = re.findall(r"uses: \S+?@v(\S+)", (PIPELINES / "github.yml").read_text())
    named += re.findall(r"python:([\w.]+)", "".join(each.read_text() for each in images))
    assert len(named) == 6
    assert [each for each in named if not re.fullmatch(r"\d+\.\d+\.\d+", each)] == []
    assert "uses:" not in (ROOT / "action.yml").read_text()


@pytest.mark.in_turn
@pytest.mark.slow
def test_the_action_fails_where_a_lidar_has_moved(project):
    reference = project / "calibration.toml"
    values = tomllib.loads(reference.read_text())
    moved = values["lidars"]["front"]
    moved["xyz_m"][0] += 0.1
    values["lidars"]["front"] = {name: moved[name] for name in ("xyz_m", "rpy_deg")}
    reference.write_text(tomli_w.dumps(values))
    steps, environment = action_steps()
    assert run(project, steps, **environment, GITHUB_ACTIONS="true") == 5
    assert 'name="front"' in (project / "artifacts" / "check.xml").read_text()


def test_recipes_name_artifacts_that_are_written():
    job = yaml.safe_load((PIPELINES / "gitlab.yml").read_text())["extrinsics"]
    named = set(job["artifacts"]["reports"].values())
    assert named == {"artifacts/check.xml", "artifacts/quality.json"}
    assert all(name in job["script"][0] for name in named)


def test_the_image_is_small_and_not_run_by_root():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert lines.index("USER 1000") < next(i for i, line in enumerate(lines) if line.startswith("ENTRYPOINT"))
    (install,) = (line for line in lines if "pip install" in line)
    assert "--no-cache-dir" in install
    assert "--no-deps" not in install
    assert ".git" in (ROOT / ".dockerignore").read_text().split()


def test_the_image_has_the_libraries_of_open3d():
    text = (ROOT / "Dockerfile").read_text()
    (packages,) = re.findall(r"apt-get install --yes --no-install-recommends \\\n(.+?) \\\n", text)
    assert sorted(packages.split()) == sorted(system_libraries.OPEN3D.values())


def test_no_layer_of_the_image_holds_the_sources():
    """They are mounted while they are installed: a layer keeps files that a later command removes."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert [line for line in lines if line.startswith(("COPY", "ADD"))] == []
    assert [line.split()[1] for line in lines if "/src" in line] == ["--mount=type=bind,target=/src,rw"]


def test_the_linter_has_nothing_to_say_of_the_image():
    linter = Path(sys.executable).with_name("hadolint")
    if not linter.exists():
        pytest.skip("hadolint has no wheel for this machine")
    told = subprocess.run([linter, "--no-color", ROOT / "Dockerfile"], capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout) == (0, "")
