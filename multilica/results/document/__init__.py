# SPDX-License-Identifier: Apache-2.0
"""The result document as pydantic models."""

from multilica.results.document.result import LidarEntry, PairEntry, ResultDocument, parse_result

__all__ = ["LidarEntry", "PairEntry", "ResultDocument", "parse_result"]
