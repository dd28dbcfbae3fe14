# SPDX-License-Identifier: Apache-2.0
"""The wheel as a user gets it: built, installed without extras into environments of its own, and used there."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from dataclasses import dataclass
from importlib import metadata
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.selection import NIGHTLY, some_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "recordings" / "samples" / "edgar-street.mcap"
OF_A_CHECKOUT = {"PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"}
SMOKE = """
import sys
import multilica
result = multilica.calibrate(sys.argv[1])
assert result.status == "complete", result
assert result._repr_html_().count("<tr>") == 5
print(multilica.__file__)
"""
WANTED = {
    "las": ["calibrate", "scans"],
    "remote": ["inspect", "https://localhost/a.mcap"],
    "s3": ["inspect", "s3://bucket/a.mcap"],
    "gcs": ["inspect", "gs://bucket/a.mcap"],
    "ros2": ["inspect", "ros2://"],
    "live": ["record", "ws://localhost:1", "--out", "a.mcap"],
    "fleet": ["fleet", "run", "scans", "--out", "store"],
}
OF_THE_PAPER = {
    "open3d": ["simulate", "--rig", "sides", "--scene", "garage", "--out", "a.mcap"],
    "networkx": ["calibrate", str(SAMPLE), "--set", "coarse.solver=maximum_clique"],
}
SIMULATE = ["simulate", "--rig", "sides", "--scene", "garage", "--sensors", "ideal", "--out", "simulated.mcap"]


@dataclass(frozen=True)
class Installed:
    """An environment with the wheel, in whose `folder` commands run."""

    programs: Path
    folder: Path

    def run(self, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return run([str(self.programs / program), *arguments], self.folder)


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name not in OF_A_CHECKOUT}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the source distribution, and the wheel that was built from it."""
    pytest.importorskip("build", reason="make installs it")
    folder = tmp_path_factory.mktemp("built")
    backend = ["hatchling", "--no-deps", "--dest", str(folder / "backend")]
    if run([sys.executable, "-m", "pip", "download", "--quiet", *backend], folder).returncode:
        pytest.skip("no package index can be reached")
    ended = run([sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)], folder)
    assert ended.returncode == 0, ended.stderr
    return folder


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel with the packages that it requires: at night as pip chooses them, else those of this environment."""
    (wheel,) = built.glob("*.whl")
    requirements = requirements_of(wheel)
    made = install(wheel, tmp_path_factory.mktemp("clean"), None if NIGHTLY else requirements)
    (made.folder / "scans").mkdir()
    for name in ("left.las", "right.las"):
        (made.folder / "scans" / name).write_bytes(b"LASF" + bytes(400))
    return made


@pytest.fixture(scope="module")
def without_open3d(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel with the first list of the page on smaller installations."""
    (wheel,) = built.glob("*.whl")
    return install(wheel, tmp_path_factory.mktemp("small"), smaller_lists()[0])


def install(wheel: Path, folder: Path, requirements: list[str] | None) -> Installed:
    """Install a wheel with packages of this environment, as the requirements name them; without these, pip chooses."""
    venv.create(folder / "venv", symlinks=True)
    options = ["--quiet", "--no-compile", "--constraint", str(ROOT / "constraints.txt")]
    if requirements is not None:
        options += ["--no-deps"]
        (site,) = folder.glob("venv/lib/*/site-packages")
        for name in closure(requirements):
            link_package(name, site)
    programs = folder / "venv" / "bin"
    pip = [sys.executable, "-m", "pip", "--python", str(programs / "python"), "install"]
    ended = run([*pip, *options, str(wheel)], folder)
    assert ended.returncode == 0, ended.stderr
    return Installed(programs, folder)


def smaller_lists() -> list[list[str]]:
    """The requirements that the page names for each smaller installation."""
    page = (ROOT / "docs" / "inputs.md").read_text(encoding="utf-8")
    blocks = re.findall(
        r"^```console\n(.*?)^```", page.partition("\n## Smaller installations\n")[2], re.MULTILINE | re.DOTALL
    )
    commands = [[shlex.split(line)[3:] for line in block.splitlines()] for block in blocks]
    return [
        [name for command in block for name in command if not {"--no-deps", "multilica"} & {*command}]
        for block in commands
        if ["--no-deps", "multilica"] in block
    ]


def requirements_of(wheel: Path) -> list[str]:
    """The requirements that the metadata of a wheel name."""
    with zipfile.ZipFile(wheel) as file:
        (name,) = [name for name in file.namelist() if name.endswith(".dist-info/METADATA")]
        lines = file.read(name).decode().splitlines()
    return [line.partition(":")[2].strip() for line in lines if line.startswith("Requires-Dist:")]


def closure(requirements: list[str]) -> set[str]:
    """The packages that are required without extras, and those that they need."""
    found: set[tuple[str, str]] = set()
    waiting = [(text, "") for text in requirements]
    while waiting:
        text, extra = waiting.pop()
        needed = Requirement(text)
        if needed.marker is None or needed.marker.evaluate({"extra": extra}):
            for each in {(needed.name, extra) for extra in ("", *needed.extras)} - found:
                found.add(each)
                waiting += [(line, each[1]) for line in metadata.requires(needed.name) or ()]
    return {name for name, _ in found}


def link_package(name: str, site: Path) -> None:
    """Lay the files of a package of this environment into another one, with its compiled modules."""
    here = Path(str(metadata.distribution(name).locate_file("")))
    for file in metadata.files(name) or ():
        compiled = Path(cache_from_source(str(file))) if file.suffix == ".py" else None
        for path in (Path(file), compiled):
            if path and ".." not in path.parts and (here / path).is_file() and not (site / path).exists():
                (site / path).parent.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(here / path, site / path)
                except OSError:  # another file system
                    shutil.copy2(here / path, site / path)


def test_the_wheel_holds_types_pages_and_the_sample(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"multilica/py.typed", "multilica_cli/samples/edgar-street.mcap"} <= names
    assert {"multilica/sinks/report/page.html", "multilica/fleet/report/page.html"} <= names
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"multilica", "multilica_cli"}


def test_the_package_index_takes_both(built: Path) -> None:
    pytest.importorskip("twine", reason="make installs it")
    files = [str(path) for path in sorted(built.glob("multilica-*"))]
    assert len(files) == 2
    ended = run([sys.executable, "-m", "twine", "check", "--strict", *files], built)
    assert ended.returncode == 0, ended.stdout


def test_the_sources_can_be_tested(built: Path) -> None:
    (sources,) = built.glob("*.tar.gz")
    with tarfile.open(sources) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"Makefile", "constraints.txt", ".ci/run", "tests/conftest.py", "multilica/py.typed"} <= names
    assert {"CITATION.cff", "Dockerfile", ".dockerignore", "action.yml", ".github/workflows/release.yml"} <= names


def test_the_environment_is_below_its_limit(installed: Installed, without_open3d: Installed) -> None:
    assert size_bytes(installed) < 1_550_000_000
    assert size_bytes(without_open3d) < 1_000_000_000


def size_bytes(environment: Installed) -> int:
    files = (file for file in (environment.folder / "venv").rglob("*") if "__pycache__" not in file.parts)
    return sum(file.stat().st_size for file in files if file.is_file() and not file.is_symlink())


def test_the_demo_places_every_lidar(installed: Installed) -> None:
    ended = installed.run("multilica", "demo", "--out", "run")
    assert ended.returncode == 0, ended.stderr
    assert "All 4 LiDARs are placed" in ended.stdout
    left = {path.name for path in (installed.folder / "run").iterdir()}
    assert {"calibration.toml", "result.json", "recording.rrd", "result.mcap", "report.html"} <= left


@pytest.mark.nightly
def test_python_calibrates_in_one_line(installed: Installed) -> None:
    ended = installed.run("python", "-c", SMOKE, str(SAMPLE))
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith(str(installed.folder))


@pytest.mark.nightly
def test_the_method_of_the_paper_works(installed: Installed) -> None:
    ended = installed.run("multilica", "calibrate", str(SAMPLE), "--preset", "paper", "--out", "paper")
    assert ended.returncode == 0, ended.stderr
    assert "All 4 LiDARs are placed" in ended.stdout + ended.stderr
    assert 'accepted_by": "fitness' in (installed.folder / "paper" / "result.json").read_text()


@pytest.mark.nightly
def test_its_algorithm_1_works(installed: Installed) -> None:
    ended = installed.run("multilica", *SIMULATE)
    assert ended.returncode == 0, ended.stderr
    command = [
        "calibrate",
        "simulated.mcap",
        "--preset",
        "paper-algorithm1",
        "--until",
        "coarse",
        "--out",
        "algorithm1",
    ]
    ended = installed.run("multilica", *command)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("module", OF_THE_PAPER)
def test_a_small_installation_tells_what_it_lacks(module: str, without_open3d: Installed) -> None:
    ended = without_open3d.run("multilica", *OF_THE_PAPER[module])
    assert ended.returncode == 1
    assert f" needs the library {module}, which is not installed; `pip install multilica` installs it" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.nightly
def test_a_small_installation_calibrates(without_open3d: Installed) -> None:
    ended = without_open3d.run("multilica", "demo", "--out", "run")
    assert ended.returncode == 0, ended.stderr
    assert "All 4 LiDARs are placed" in ended.stdout


def test_the_smaller_list_is_the_core_without_two(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    core = [each for each in map(Requirement, requirements_of(wheel)) if "extra" not in str(each.marker)]
    named = {canonicalize_name(Requirement(text).name) for text in smaller_lists()[0]}
    assert {canonicalize_name(each.name) for each in core} - named == {"open3d", "open3d-cpu", "networkx"}


@pytest.mark.nightly
def test_open3d_works_without_its_requirements(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    small = install(wheel, tmp_path, smaller_lists()[0])
    (site,) = tmp_path.glob("venv/lib/*/site-packages")
    for name in ("open3d-cpu", "networkx"):
        link_package(name, site)
    for command in (SIMULATE, ["calibrate", "simulated.mcap", "--preset", "paper", "--until", "fine"]):
        ended = small.run("multilica", *command)
        assert ended.returncode == 0, ended.stderr


@pytest.mark.nightly
def test_python_alone_calibrates_with_few_libraries(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    tiny = install(wheel, tmp_path, smaller_lists()[1])
    assert size_bytes(tiny) < 300_000_000
    ended = tiny.run("python", "-c", SMOKE, str(SAMPLE))
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("extra", some_of(WANTED, 2))
def test_a_missing_extra_is_one_sentence(extra: str, installed: Installed) -> None:
    ended = installed.run("multilica", *WANTED[extra])
    assert ended.returncode == 1
    told = [line for line in ended.stderr.splitlines() if line.startswith("multilica: ")]
    assert len(told) == 1
    assert re.search(rf" needs the library \w+, which is not installed; `pip install 'multilica\[{extra}\]'`", told[0])
    assert "Traceback" not in ended.stderr
    assert not (installed.folder / "store").exists()


def test_the_doctor_finds_the_core_whole(installed: Installed) -> None:
    ended = installed.run("multilica", "doctor")
    assert ended.returncode == 0, ended.stdout
    assert "pip install 'multilica[all,ros2]'" in ended.stdout
    assert installed.run("multilica", "fleet", "--help").returncode == 0
