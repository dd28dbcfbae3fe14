# SPDX-License-Identifier: Apache-2.0
"""The explanation of a saved run."""

from __future__ import annotations

from pathlib import Path

from multilica.errors import UnreadableSourceError
from multilica.explanation import Explanation, explain
from multilica.fleet.run_documents import read_run_document

__all__ = ["explain_run"]


def explain_run(path: Path) -> Explanation:
    """Explain a run directory, its `result.json`, a recording, also one that was cut off, or its `result.mcap`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a run.
        UnreadableSourceError: damaged, or not of a run.
    """
    run = read_run_document(path)
    try:
        return explain(run.document)
    except KeyError as error:
        raise UnreadableSourceError(f"{path} is not a whole result: it has no {error}.") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise UnreadableSourceError(f"{path} is not a whole result: {error}.") from error
