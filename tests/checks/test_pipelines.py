# SPDX-License-Identifier: Apache-2.0
"""The recipes for CI services, with their steps run as the service would run them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import tomli_w
import yaml

from multilica import system_libraries
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import write_thinned_sample
from tests.selection import some_of

ROOT = Path(__file__).parents[2]
PIPELINES = ROOT / "docs" / "pipelines"


def github_steps() -> list[str]:
    jobs = yaml.safe_load((PIPELINES / "github.yml").read_text())["jobs"]
    return [step["run"] for step in jobs["check"]["steps"] if "run" in step]


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
    """A project with a recording, its extrinsics, and programs of the service that only note their calls."""
    for name in ("recordings", "bin"):
        (tmp_path / name).mkdir()
    write_thinned_sample(tmp_path / "recordings" / "drive.mcap")
    shutil.copy(find_sample().truth, tmp_path / "calibration.toml")
    for name in ("pip", "gh"):
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\necho "{name} $*" >> "{tmp_path}/calls.txt"\n')
        program.chmod(0o755)
    program = tmp_path / "bin" / "multilica"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m multilica_cli "$@"\n')
    program.chmod(0o755)
    return tmp_path


def run(project: Path, steps: list[str], **variables: str) -> int:
    """Run steps as `bash -e` does, and return the first exit code that is not 0."""
    path = f"{project / 'bin'}{os.pathsep}{os.environ['PATH']}"
    python = f"{ROOT}{os.pathsep}{ROOT / 'cli'}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": python, **variables}
    for step in steps:
        shown = re.sub(r"\$\{\{[^}]+\}\}", "7", step)
        command = ["bash", "-e", "-o", "pipefail", "-c", shown]
        outcome = subprocess.run(command, cwd=project, env=environment, check=False)
        if outcome.returncode:
            return outcome.returncode
    return 0


@pytest.mark.slow
@pytest.mark.parametrize("steps", some_of(RECIPES, 1, lambda steps: f"docs/pipelines/{RECIPES[steps]}"))
def test_each_recipe_passes_and_leaves_its_artifacts(project, steps):
    assert run(project, steps()) == 0
    left = {path.name for path in (project / "artifacts").iterdir()}
    assert {"run", "check.xml", "check.md", "check.md.png"} <= left
    assert (project / "artifacts" / "run" / "recording.rrd").exists()
    assert "pip install multilica" in (project / "calls.txt").read_text()
    if steps is github_steps:
        assert "gh pr comment 7 --body-file artifacts/check.md" in (project / "calls.txt").read_text()


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


def test_the_linter_has_nothing_to_say_of_the_image():
    linter = Path(sys.executable).with_name("hadolint")
    if not linter.exists():
        pytest.skip("hadolint has no wheel for this machine")
    told = subprocess.run([linter, "--no-color", ROOT / "Dockerfile"], capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout) == (0, "")
