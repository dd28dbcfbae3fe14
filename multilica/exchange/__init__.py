# SPDX-License-Identifier: Apache-2.0
"""Extrinsics in the formats of other programs."""

from multilica.exchange.formats import CLOUD_FORMATS, FORMATS, ExchangeFormat
from multilica.exchange.reading import read_extrinsics
from multilica.exchange.writing import RunExport, export_extrinsics, export_run

__all__ = [
    "CLOUD_FORMATS",
    "FORMATS",
    "ExchangeFormat",
    "RunExport",
    "export_extrinsics",
    "export_run",
    "read_extrinsics",
]
