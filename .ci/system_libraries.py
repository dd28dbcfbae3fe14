# SPDX-License-Identifier: Apache-2.0
"""Installs the system packages that pip cannot bring, or says how.

Runs before the environment exists: standard library only, any Python 3.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

OLDEST_PYTHON = (3, 11)
OPEN3D = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
}
VENV_MODULES = ("venv", "ensurepip")
VULKAN_DRIVERS = "/usr/share/vulkan/icd.d"
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def missing_packages() -> list[str]:
    """Packages without which multilica does not run."""
    packages = [package for library, package in OPEN3D.items() if not loads(library)]
    if any(importlib.util.find_spec(module) is None for module in VENV_MODULES):
        packages.append(f"python{sys.version_info.major}.{sys.version_info.minor}-venv")
    return packages


def missing_for_pictures() -> list[str]:
    """Packages that the viewer needs where there is no screen; tests skip without them."""
    packages = [] if loads("libvulkan.so.1") else ["libvulkan1"]
    if not any(Path(VULKAN_DRIVERS).glob("lvp_icd*")):
        packages.append("mesa-vulkan-drivers")
    return packages


def missing_browser() -> list[str]:
    """The package with which reports are read where there is no browser; tests skip without it."""
    return [] if any(map(shutil.which, BROWSERS)) else ["chromium-headless-shell"]


def loads(library: str) -> bool:
    """Whether the dynamic linker finds that library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


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
        "--pictures", action="store_true", help="also what tests draw pictures with; never fails for want of it"
    )
    pictures = parser.parse_args().pictures
    if sys.version_info < OLDEST_PYTHON:
        sys.exit(
            f"multilica needs Python 3.11 or newer, {sys.executable} is older; name another: make PYTHON=python3.12 ..."
        )
    packages = missing_packages()
    if packages and not install(packages):
        sys.exit(
            "These system packages are missing; install them, then run make again:\n  sudo apt-get install "
            + " ".join(packages)
        )
    # One after the other: not every distribution has the browser.
    for extra in (missing_for_pictures(), missing_browser()) if pictures else ():
        if extra and not install(extra):
            print("some tests are skipped; they need: sudo apt-get install", *extra)


if __name__ == "__main__":
    main()
