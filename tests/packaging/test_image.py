# SPDX-License-Identifier: Apache-2.0
"""The Docker image: built where there is Docker, and its steps in a bare environment everywhere."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
import venv
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.packaging.test_wheel import link_package
from tests.selection import NIGHTLY

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
LINES = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
IMAGE = "multilica-of-tests"

pytestmark = [pytest.mark.slow, pytest.mark.nightly]


def values(instruction: str) -> list[str]:
    """What follows each instruction of that name."""
    return [line.removeprefix(instruction).strip() for line in LINES if line.startswith(f"{instruction} ")]


@dataclass(frozen=True)
class Bare:
    """An environment as the base image has it: Python, pip, and a shell without variables."""

    folder: Path

    @property
    def site(self) -> Path:
        (found,) = self.folder.glob("venv/lib/*/site-packages")
        return found

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        """Run a command of the Dockerfile, with the mounted sources in the folder."""
        programs = f"{self.folder}/programs:{self.folder}/venv/bin:/usr/bin:/bin"
        variables = {"PATH": programs, "HOME": str(self.folder), "TMPDIR": os.environ["TMPDIR"], "LANG": "C.UTF-8"}
        command = re.sub(r"--mount=\S+ ", "", command).replace("/src", f"{self.folder}/src")
        shell = ["sh", "-c", command]
        return subprocess.run(
            shell, cwd=self.folder / "data", env=variables, capture_output=True, text=True, check=False
        )


def needed(extras: list[str]) -> set[str]:
    """The packages that the image needs, as far as this environment has them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *(line for each in extras for line in project["optional-dependencies"][each])]
    waiting, found = [(line, "") for line in lines], set()
    while waiting:
        line, extra = waiting.pop()
        asked = Requirement(line)
        if asked.marker is None or asked.marker.evaluate({"extra": extra}):
            for each in {(asked.name, extra) for extra in ("", *asked.extras)} - found:
                found.add(each)
                with suppress(metadata.PackageNotFoundError):
                    waiting += [(line, each[1]) for line in metadata.requires(each[0]) or ()]
    return {name for name, _ in found}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Bare:
    """The environment before the first step; without MULTILICA_NIGHTLY it has the packages of this one."""
    folder = tmp_path_factory.mktemp("bare")
    ignored = [each for each in (ROOT / ".dockerignore").read_text().splitlines() if not each.startswith("#")]
    shutil.copytree(ROOT, folder / "src", ignore=shutil.ignore_patterns(*ignored, ".*_cache", "__pycache__"))
    for name in ("data", "programs"):
        (folder / name).mkdir()
    program = folder / "programs" / "useradd"  # the real one would change this machine
    program.write_text(f'#!/bin/sh\necho "$*" >> "{folder}/useradd.txt"\n')
    program.chmod(0o755)
    venv.create(folder / "venv", with_pip=True)
    made = Bare(folder)
    if made.run("pip download --quiet --no-deps --dest backend hatchling").returncode:
        pytest.skip("no package index can be reached")
    shutil.rmtree(folder / "data" / "backend")
    if not NIGHTLY:
        (install,) = (step for step in values("RUN") if "pip install" in step)
        for name in needed(re.search(r"/src\[(.+?)\]", install)[1].split(",")):
            with suppress(metadata.PackageNotFoundError):
                link_package(name, made.site)
    return made


@pytest.fixture(scope="module")
def image(bare: Bare) -> Bare:
    """The environment after the Dockerfile's steps, but Debian's packages: these would change this machine."""
    for step in values("RUN"):
        if step.startswith("apt-get"):
            continue
        ended = bare.run(step)
        assert ended.returncode == 0, f"{step}: {ended.stderr}"
    return bare


def test_the_steps_install_a_program_that_calibrates(image: Bare) -> None:
    shutil.copy(SAMPLE, image.folder / "data" / "drive.mcap")
    (entry,) = (json.loads(value) for value in values("ENTRYPOINT"))
    ended = image.run(f"{entry[0]} calibrate drive.mcap --until preprocess --out run --workers 1")
    assert ended.returncode == 0, ended.stderr
    assert (image.folder / "data" / "run" / "recording.rrd").is_file()
    assert image.run(f"{entry[0]} fleet --help").returncode == 0


def test_the_sources_are_installed_and_not_linked(image: Bare) -> None:
    shutil.rmtree(image.folder / "src")  # as the mount ends with its step
    ended = image.run("python -c 'import multilica, multilica_cli; print(multilica.__file__)'")
    assert Path(ended.stdout.strip()).is_relative_to(image.site)
    assert "--uid 1000" in (image.folder / "useradd.txt").read_text()


def has_docker() -> bool:
    docker = shutil.which("docker")
    return docker is not None and subprocess.run([docker, "info"], capture_output=True, check=False).returncode == 0


@pytest.mark.shows("Dockerfile", ".dockerignore")
def test_docker_builds_an_image_that_calibrates() -> None:
    if not has_docker():
        pytest.skip("no Docker on this machine")

    def docker(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "DOCKER_BUILDKIT": "1"}
        return subprocess.run(
            ["docker", *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )

    try:
        built = docker("build", "--tag", IMAGE, ".")
        assert built.returncode == 0, built.stderr
        shown = docker("run", "--rm", IMAGE, "demo", "--out", "/tmp/run")  # noqa: S108 - of the container
        assert "All 4 LiDARs are placed" in shown.stdout, shown.stderr
        left = docker("run", "--rm", "--entrypoint", "sh", IMAGE, "-c", "id -u; find /src -type f 2>/dev/null")
        assert left.stdout.split() == ["1000"]
    finally:
        docker("rmi", "--force", IMAGE)
