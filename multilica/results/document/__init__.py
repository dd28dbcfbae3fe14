# SPDX-License-Identifier: Apache-2.0
"""The result document as pydantic models."""

from multilica.results.document.lidars import LidarEntry
from multilica.results.document.pairs import PairEntry
from multilica.results.document.result import ResultDocument, parse_result

__all__ = ["LidarEntry", "PairEntry", "ResultDocument", "parse_result"]
