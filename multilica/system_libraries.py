# SPDX-License-Identifier: Apache-2.0
"""System libraries that pip cannot bring, and the command that installs them.

Standard library only, for any Python 3: `.ci/system_libraries.py` uses it before the environment exists.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from pathlib import Path

OPEN3D: Mapping[str, str] = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
}
"""Libraries that the import of Open3D loads: name of the library -> package of Debian and Ubuntu."""
SOFTWARE_DRIVER = "lvp_icd"
"""The Vulkan driver that draws without a GPU."""
_VIEWER: Mapping[str, str] = {"libudev.so.1": "libudev1", "libvulkan.so.1": "libvulkan1"}
_VULKAN_DRIVERS = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")


def loads(library: str) -> bool:
    """Return whether the dynamic linker finds that library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def missing_for_open3d() -> list[str]:
    """List the packages without which Open3D cannot be imported."""
    return [package for library, package in OPEN3D.items() if not loads(library)]


def missing_for_pictures(*, software: bool = False) -> list[str]:
    """List the packages that Rerun's viewer lacks to draw without a screen.

    Args:
        software: only the driver that draws without a GPU counts.
    """
    packages = [package for library, package in _VIEWER.items() if not loads(library)]
    drivers = [driver for driver in vulkan_drivers() if not software or driver == SOFTWARE_DRIVER]
    return packages if drivers else [*packages, "mesa-vulkan-drivers"]


def vulkan_drivers() -> list[str]:
    """List the installed Vulkan drivers by the names of their files, such as ``lvp_icd``."""
    files = (file for folder in _VULKAN_DRIVERS for file in Path(folder).glob("*.json"))
    return sorted({file.name.split(".")[0] for file in files})


def apt_command(packages: Iterable[str]) -> str:
    """Return the command that installs packages of Debian and Ubuntu."""
    return f"sudo apt-get install {' '.join(packages)}"
