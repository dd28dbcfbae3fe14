# SPDX-License-Identifier: Apache-2.0
"""The explanation of a saved run."""

from __future__ import annotations

from pathlib import Path

from multilica.explanation import Explanation, explain
from multilica.fleet.run_documents import read_run_document, require_whole

__all__ = ["explain_run"]


def explain_run(path: Path) -> Explanation:
    """Explain a run directory, its `result.json`, a recording, also one that was cut off, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    run = read_run_document(path)
    with require_whole(path):
        return explain(run.document)
