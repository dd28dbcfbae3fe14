# SPDX-License-Identifier: Apache-2.0
"""Explanation of a saved run."""

from pathlib import Path

from multilica.diagnosis import Explanation, explain
from multilica.runs.run_documents import read_run_document

__all__ = ["explain_run"]


def explain_run(path: Path) -> Explanation:
    """Explain a run directory, its `result.json`, a recording, also a cut-off one, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    return explain(read_run_document(path).document)
