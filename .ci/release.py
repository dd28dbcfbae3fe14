# SPDX-License-Identifier: Apache-2.0
"""Steps of a release that need the files of the project: checks, notes, README, recipe for conda, versions of the site.

`.github/workflows/release.yml` runs them; CONTRIBUTING.md has the whole procedure.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
CONDA_NAMES = {"isal": "python-isal", "open3d-cpu": "open3d", "typing-extensions": "typing_extensions"}
"""Name in the package index -> name in conda-forge, where they differ."""
FIRST_PAGE = """\
<!doctype html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={}/">
<title>multilica</title>
"""
RECIPE = """\
schema_version: 1

context:
  version: "{version}"
  python_min: "{python_min}"

package:
  name: multilica
  version: ${{{{ version }}}}

source:
  url: {repository}/releases/download/v${{{{ version }}}}/multilica-${{{{ version }}}}.tar.gz
  sha256: {sha256}

build:
  number: 0
  noarch: python
  script: ${{{{ PYTHON }}}} -m pip install . -vv --no-deps --no-build-isolation
  python:
    entry_points:
      - multilica = {entry_point}

requirements:
  host:
    - python ${{{{ python_min }}}}.*
    - pip
{host}
  run:
    - __linux
    - python >=${{{{ python_min }}}}
{run}

tests:
  - python:
      imports:
        - multilica
        - multilica_cli
      python_version: ${{{{ python_min }}}}.*
      # conda-forge's Open3D is named open3d on every machine; the metadata of multilica name open3d-cpu on some.
      pip_check: false
  - requirements:
      run:
        - python ${{{{ python_min }}}}.*
    script:
      - multilica demo

about:
  homepage: {repository}
  repository: {repository}
  summary: {summary}
  license: {license}
  license_file: LICENSE

extra:
  recipe-maintainers:
    - {maintainer}
"""


def project() -> dict[str, object]:
    """Return the table `project` of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def version() -> str:
    """Return the version of the sources."""
    text = (ROOT / "multilica" / "__init__.py").read_text(encoding="utf-8")
    return re.findall(r'^__version__ = "(.+)"$', text, re.MULTILINE)[0]


def check(tag: str) -> None:
    """Exit with one sentence unless the tag names the version of the sources, and the changelog and citation do too."""
    number = version()
    if tag != f"v{number}":
        sys.exit(f"The tag is {tag}, but multilica/__init__.py has the version {number}; tag v{number}, or change it.")
    cited = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    if cited != [number]:
        sys.exit(f"CITATION.cff names the version {', '.join(cited) or 'none'}, not {number}.")
    notes()


def notes() -> str:
    """Return the section of the changelog about the version of the sources, without its heading."""
    number = version()
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## \[{re.escape(number)}\] - \d{{4}}-\d\d-\d\d$", text, re.MULTILINE)
    if heading is None:
        sys.exit(f"CHANGELOG.md has no heading '## [{number}] - YYYY-MM-DD'; put it in place of '## [Unreleased]'.")
    return re.split(r"^## ", text[heading.end() :], maxsplit=1, flags=re.MULTILINE)[0].strip()


def linked(text: str, repository: str) -> str:
    """Return a page whose links lead to the files of the release, as the package index has only the page."""
    at = f"v{version()}"
    text = re.sub(r"(!\[[^]]*\])\((?!https?:)", rf"\1({repository}/raw/{at}/", text)
    return re.sub(r"(?<!!)(\[[^]]*\])\((?!https?:|#)", rf"\1({repository}/blob/{at}/", text)


def recipe(sources: Path, repository: str) -> str:
    """Return the recipe for conda-forge.

    Args:
        sources: the source distribution, as the release of the repository has it.
        repository: its address, without a slash at the end; its owner maintains the recipe.
    """
    found = project()
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    return RECIPE.format(
        version=version(),
        python_min=found["requires-python"].removeprefix(">="),
        repository=repository,
        sha256=hashlib.sha256(sources.read_bytes()).hexdigest(),
        entry_point=found["scripts"]["multilica"],
        host="\n".join(conda_requirements(build)),
        run="\n".join(conda_requirements(found["dependencies"])),
        summary=json.dumps(found["description"]),
        license=found["license"],
        maintainer=repository.split("/")[-2],
    )


def conda_requirements(texts: list[str]) -> Iterator[str]:
    """Yield the requirements as lines of a recipe, in conda-forge's names; those of one name for two machines once."""
    lines = []
    for requirement in map(Requirement, texts):
        name = CONDA_NAMES.get(requirement.name, requirement.name)
        lines.append(f"    - {name} {requirement.specifier}")
    yield from dict.fromkeys(lines)


def add_version(site: Path, pages: Path, base: str) -> None:
    """Put a built site beside those of earlier versions, with a list of all and a first page that leads to the newest.

    Args:
        site: the site of this version.
        pages: the folder of all versions, whose content is published.
        base: its path on the server, with a slash at both ends.
    """
    folder = pages / version()
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(site, folder)
    numbers = sorted((path.parent.name for path in pages.glob("[0-9]*/index.html")), key=Version, reverse=True)
    versions = [{"name": number, "version": number, "url": f"{base}{number}/"} for number in numbers]
    (pages / "versions.json").write_text(json.dumps(versions, indent=1), encoding="utf-8")
    (pages / "index.html").write_text(FIRST_PAGE.format(numbers[0]), encoding="utf-8")
    (pages / ".nojekyll").touch()  # or folders like _static are left out


def main() -> None:
    """Run one step."""
    parser = argparse.ArgumentParser(description=__doc__)
    steps = parser.add_subparsers(dest="step", required=True)
    steps.add_parser("check", help=check.__doc__).add_argument("tag")
    steps.add_parser("notes", help="print the section of the changelog about this version")
    read = steps.add_parser("readme", help="make the links of README.md lead to the files of the release")
    made = steps.add_parser("recipe", help="print the recipe for conda-forge")
    made.add_argument("sources", type=Path, help="the source distribution")
    for step in (read, made):
        step.add_argument("--repository", required=True, help="address of the repository")
    added = steps.add_parser("pages", help="put a built site beside those of earlier versions")
    added.add_argument("site", type=Path)
    added.add_argument("pages", type=Path)
    added.add_argument("--base", default="/", help="path of the pages on the server")
    options = parser.parse_args()
    if options.step == "check":
        check(options.tag)
    elif options.step == "notes":
        print(notes())
    elif options.step == "readme":
        path = ROOT / "README.md"
        path.write_text(linked(path.read_text(encoding="utf-8"), options.repository), encoding="utf-8")
    elif options.step == "recipe":
        print(recipe(options.sources, options.repository), end="")
    else:
        add_version(options.site, options.pages, options.base)


if __name__ == "__main__":
    main()
