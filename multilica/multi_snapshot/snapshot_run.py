# SPDX-License-Identifier: Apache-2.0
"""One snapshot of several with its calibration."""

from dataclasses import dataclass

from multilica.config import STAGES, CalibrationConfig
from multilica.errors import UsageError
from multilica.results import CalibrationResult

__all__ = ["SnapshotRun", "require_joinable"]


@dataclass(frozen=True, slots=True, eq=False)
class SnapshotRun:
    """One snapshot with its own calibration.

    Args:
        name: unique name of the snapshot.
        result: None if the snapshot was refused.
        source, source_sha256: as in `Snapshot`.
        refusal: why it was refused; empty if it was calibrated.
    """

    name: str
    result: CalibrationResult | None
    source: str = ""
    source_sha256: str = ""
    refusal: str = ""


def require_joinable(config: CalibrationConfig) -> None:
    """Check that calibrations with this configuration can be joined.

    Raises:
        UsageError: they stop too early, or do not compute the covariance of a pair.
    """
    if STAGES.index(config.until) < STAGES.index("refine"):
        raise UsageError(
            f"Found several snapshots with --until {config.until}; "
            "a joint result needs the stages up to refine: leave --until out, or give one snapshot."
        )
    if not config.refine.enabled or config.fine.engine != "small_gicp":
        raise UsageError(
            f"Found several snapshots with refine.enabled={str(config.refine.enabled).lower()} and "
            f"fine.engine={config.fine.engine} (preset {config.preset}); a joint result weighs pairs by what "
            "refinement measures with small_gicp: use both, or give one snapshot."
        )
