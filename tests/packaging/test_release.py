# SPDX-License-Identifier: Apache-2.0
"""The steps of a release: its checks, notes, recipe and site, and the workflow that runs them."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import runpy
import shutil
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from packaging.requirements import Requirement

from multilica import __version__, system_libraries

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8"))
JOBS = WORKFLOW["jobs"]
CHANGELOG = f"""# Changelog

## [{__version__}] - 2026-12-01

### Added

- A thing.

## [0.0.9] - 2026-01-01

- Old.
"""
IN_CONDA = {"isal": "python-isal", "typing-extensions": "typing_extensions"}
REPOSITORY = "https://github.com/someone/multilica"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The script in a copy of what it reads."""
    spec = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "multilica/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "CHANGELOG.md").write_text(CHANGELOG, encoding="utf-8")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    return module


def test_a_tag_that_fits_passes(script: ModuleType) -> None:
    script.check(f"v{__version__}")


def test_the_citation_has_the_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert citation["license"] == PROJECT["license"]
    assert citation["abstract"] == PROJECT["description"]
    assert citation["references"][0]["doi"] in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "old", "told"),
    [
        ("multilica/__init__.py", f'"{__version__}"', "but multilica/__init__.py has the version 9.9.9; tag v9.9.9"),
        ("CITATION.cff", f"version: {__version__}", f"CITATION.cff names the version none, not {__version__}"),
        ("CHANGELOG.md", f"[{__version__}] - 2026-12-01", rf"no heading '## \[{__version__}\] - YYYY-MM-DD'"),
    ],
)
def test_what_does_not_fit_is_told(script: ModuleType, file: str, old: str, told: str) -> None:
    path = script.ROOT / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, '"9.9.9"' if file.endswith(".py") else "[Unreleased]"), encoding="utf-8")
    with pytest.raises(SystemExit, match=told):
        script.check(f"v{__version__}")


def test_notes_are_the_section_of_the_version(script: ModuleType) -> None:
    assert script.notes() == "### Added\n\n- A thing."


def test_the_readme_of_the_index_leads_to_the_release(script: ModuleType) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", script.linked(readme, REPOSITORY))
    assert len(links) == len(re.findall(r"\]\(", readme))
    assert {link.split(":")[0] for link in links} == {"https"}
    assert f"{REPOSITORY}/raw/v{__version__}/docs/pictures/result.png" in links
    ours = [link for link in links if link.startswith(REPOSITORY)]
    files = [link.split(f"/v{__version__}/")[1].split("#")[0] for link in ours]
    assert [name for name in files if not (ROOT / name).is_file()] == []


def test_the_recipe_requires_what_the_package_does(script: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "sources.tar.gz").write_bytes(b"sources")
    text = script.recipe(tmp_path / "sources.tar.gz", REPOSITORY)
    recipe = yaml.safe_load(text)
    assert recipe["context"] == {"version": __version__, "python_min": PROJECT["requires-python"].removeprefix(">=")}
    assert recipe["source"]["sha256"] == hashlib.sha256(b"sources").hexdigest()
    assert recipe["source"]["url"].startswith(f"{REPOSITORY}/releases/download/v$")
    assert recipe["build"]["python"]["entry_points"] == [f"multilica = {PROJECT['scripts']['multilica']}"]
    assert recipe["about"]["summary"] == PROJECT["description"]
    assert recipe["extra"]["recipe-maintainers"] == ["someone"]
    linux, python, *others = recipe["requirements"]["run"]
    assert (linux, python) == ("__linux", "python >=${{ python_min }}")
    wanted = [Requirement(each) for each in PROJECT["dependencies"] if not each.startswith("open3d-cpu")]
    assert sorted(others) == sorted(f"{IN_CONDA.get(each.name, each.name)} {each.specifier}" for each in wanted)


def test_each_version_has_a_site(script: ModuleType, tmp_path: Path) -> None:
    site, pages = tmp_path / "site", tmp_path / "pages"
    for folder in (site, pages / "0.0.9", pages / "0.0.10", pages / __version__, pages / ".git"):
        folder.mkdir(parents=True)
        (folder / "index.html").write_text(folder.name, encoding="utf-8")
    (pages / __version__ / "gone.html").touch()
    script.add_version(site, pages, "/multilica/")
    numbers = [__version__, "0.0.10", "0.0.9"]
    assert [(pages / number / "index.html").read_text(encoding="utf-8") for number in numbers] == ["site", *numbers[1:]]
    assert not (pages / __version__ / "gone.html").exists()
    versions = json.loads((pages / "versions.json").read_text(encoding="utf-8"))
    assert versions == [{"name": each, "version": each, "url": f"/multilica/{each}/"} for each in numbers]
    assert f'content="0; url={__version__}/"' in (pages / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("base", ["", "/multilica/"])
def test_the_site_of_a_release_lists_the_others(base: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTILICA_SITE_BASE", base)
    options = runpy.run_path(str(ROOT / "docs" / "site" / "conf.py"))["html_theme_options"]
    assert ("version-switcher" in options["navbar_end"]) == bool(base)
    wanted = {"json_url": "/multilica/versions.json", "version_match": __version__} if base else None
    assert options.get("switcher") == wanted


def test_nothing_is_uploaded_before_it_was_tried() -> None:
    assert {*JOBS["upload"]["needs"]} == {"wheel", "image"}
    assert JOBS["wheel"]["needs"] == "build"
    assert {name for name, job in JOBS.items() if job.get("needs") == "upload"} == {"release", "pages"}
    tried = [step["run"] for step in JOBS["wheel"]["steps"] if "run" in step]
    assert {"pip install dist/*.whl", "multilica demo"} <= {*tried}
    assert any("--preset paper" in command for command in tried)


def test_only_the_upload_has_the_identity() -> None:
    assert WORKFLOW["permissions"] == {}
    assert [name for name, job in JOBS.items() if "id-token" in job["permissions"]] == ["upload"]
    assert JOBS["upload"]["permissions"] == {"id-token": "write"}
    assert not any("secrets." in line for line in (ROOT / ".github/workflows/release.yml").read_text().splitlines())
    assert [step["uses"].split("@")[0] for step in JOBS["upload"]["steps"]] == [
        "actions/download-artifact",
        "pypa/gh-action-pypi-publish",
    ]


def test_the_workflow_installs_what_open3d_needs() -> None:
    (command,) = (step["run"] for step in JOBS["wheel"]["steps"] if "apt-get" in step.get("run", ""))
    assert {*re.findall(r"lib\S+", command)} == {*system_libraries.OPEN3D.values()}


def test_steps_that_the_workflow_runs_exist(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = [
        step["run"] for job in JOBS.values() for step in job["steps"] if ".ci/release.py" in step.get("run", "")
    ]
    steps = {step for command in commands for step in re.findall(r"\.ci/release\.py (\w+)", command)}
    assert steps == {"check", "notes", "readme", "recipe", "pages"}
    for step in steps:
        monkeypatch.setattr("sys.argv", ["release.py", step, "--help"])
        with pytest.raises(SystemExit) as ended:
            script.main()
        assert ended.value.code == 0
