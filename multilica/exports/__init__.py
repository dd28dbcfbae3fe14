# SPDX-License-Identifier: Apache-2.0
"""Extrinsics in the formats of other programs."""

from importlib import import_module
from typing import TYPE_CHECKING

from multilica.exports.formats import CLOUD_FORMATS, FORMATS

if TYPE_CHECKING:
    from multilica.exports.files import RunExport, export_extrinsics, export_run, read_extrinsics

__all__ = ["CLOUD_FORMATS", "FORMATS", "RunExport", "export_extrinsics", "export_run", "read_extrinsics"]


def __getattr__(name: str) -> object:
    """Import a function when it is first used, so that the list of formats stays light."""
    if name not in __all__:
        raise AttributeError(f"module 'multilica.exports' has no attribute '{name}'")
    return getattr(import_module("multilica.exports.files"), name)
