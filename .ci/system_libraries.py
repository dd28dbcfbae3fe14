# SPDX-License-Identifier: Apache-2.0
"""Installs the system packages that pip cannot bring, or says how.

Runs before the environment exists: standard library only, any Python 3.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from multilica import system_libraries

OLDEST_PYTHON = (3, 11)
VENV_MODULES = ("venv", "ensurepip")
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def missing_packages() -> list[str]:
    """Packages without which the environment of the developers cannot be made."""
    packages = system_libraries.missing_for_open3d()
    if any(importlib.util.find_spec(module) is None for module in VENV_MODULES):
        packages.append(f"python{sys.version_info.major}.{sys.version_info.minor}-venv")
    return packages


def missing_for_pictures() -> list[str]:
    """Packages that the viewer needs where there is no screen and no GPU; tests skip without them."""
    return system_libraries.missing_for_pictures(software=True)


def missing_browser() -> list[str]:
    """The package with which reports are read where there is no browser; tests skip without it."""
    return [] if any(map(shutil.which, BROWSERS)) else ["chromium-headless-shell"]


def missing_jq() -> list[str]:
    """The package with which commands of the documentation read JSON; their tests skip without it."""
    return [] if shutil.which("jq") else ["jq"]


def install(packages: list[str]) -> bool:
    """Install with apt; returns whether that worked."""
    prefix = privilege()
    if prefix is None or shutil.which("apt-get") is None:
        return False
    command = [*prefix, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq", "-o", "DPkg::Lock::Timeout=120"]
    print("installing", *packages, flush=True)
    subprocess.run([*command, "update"], check=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    arguments = ["install", "--yes", "--no-install-recommends", *packages]
    return (
        subprocess.run(
            [*command, *arguments], check=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        ).returncode
        == 0
    )


def privilege() -> list[str] | None:
    """What makes a command run as root: nothing for root, sudo if it asks no password, else None."""
    if os.geteuid() == 0:
        return []
    if (
        shutil.which("sudo")
        and subprocess.run(["sudo", "-n", "true"], check=False, capture_output=True).returncode == 0
    ):
        return ["sudo", "-n"]
    return None


def main() -> None:
    """Install what is missing; exit with the command to run where that is not allowed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--pictures",
        action="store_true",
        help="also what tests draw pictures and read JSON with; never fails for want of it",
    )
    pictures = parser.parse_args().pictures
    if sys.version_info < OLDEST_PYTHON:
        sys.exit(
            f"multilica needs Python 3.11 or newer, {sys.executable} is older; name another: make PYTHON=python3.12 ..."
        )
    packages = missing_packages()
    if packages and not install(packages):
        sys.exit(
            "These system packages are missing; install them, then run make again:\n  "
            + system_libraries.apt_command(packages)
        )
    # One after the other: not every distribution has each.
    for extra in (missing_for_pictures(), missing_browser(), missing_jq()) if pictures else ():
        if extra and not install(extra):
            print("some tests are skipped; they need: sudo apt-get install", *extra)


if __name__ == "__main__":
    main()
