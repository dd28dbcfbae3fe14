# SPDX-License-Identifier: Apache-2.0
"""Extrinsics in the formats of other programs."""

from multilica.exports.formats import CLOUD_FORMATS, FORMATS, ExchangeFormat
from multilica.exports.reading import read_extrinsics
from multilica.exports.writing import RunExport, export_extrinsics, export_run

__all__ = [
    "CLOUD_FORMATS",
    "FORMATS",
    "ExchangeFormat",
    "RunExport",
    "export_extrinsics",
    "export_run",
    "read_extrinsics",
]
