# SPDX-License-Identifier: Apache-2.0
"""The loop that listens, waits for a standstill, verifies, and tells."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from multilica.checks import RigCheck, RigTolerances, absent_lidars, check_found, read_reference, with_absent
from multilica.config import CalibrationConfig
from multilica.errors import MissingDependencyError, MultilicaError, UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.ingest import TakenSnapshot, require_calibratable
from multilica.results import CalibrationResult
from multilica.verification import register_from_known

Outcome = Literal["within", "outside", "undecided", "moving", "failed"]

PAUSE_S = 1.0
"""Between two looks at a vehicle that gives no verdict."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One look at the vehicle.

    Args:
        time_ns: of the last scan; of the look if there is no scan.
        outcome: the verdict, or why there is none.
        text: the outcome, for people; one line.
        check, found, known: of a verdict; None without one.
        silent: topics without scans.
    """

    time_ns: int
    outcome: Outcome
    text: str
    check: RigCheck | None = None
    found: CalibrationResult | None = None
    known: Extrinsics | None = None
    silent: tuple[str, ...] = ()

    @property
    def is_verdict(self) -> bool:
        """True if the vehicle stood and was verified."""
        return self.check is not None


@dataclass(frozen=True, slots=True, eq=False)
class WatchRequest:
    """Settings of a watch.

    Args:
        look: takes a snapshot of the vehicle, in bounded time and memory.
        calibration: file or run with the poses; it is read at each look, so a new calibration takes effect.
        interval_s: least time from one verdict to the next.
    """

    look: Callable[[], TakenSnapshot]
    calibration: Path
    tolerances: RigTolerances
    config: CalibrationConfig
    interval_s: float


def watch_vehicle(
    request: WatchRequest,
    tell: Callable[[Observation], None],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Verify the vehicle whenever it stands, until an exception of `sleep` or a signal ends it.

    Whatever the vehicle sends or fails to send is an observation, never the end.

    Args:
        tell: called with each look at the vehicle.

    Raises:
        MissingDependencyError: a library for this source is not installed.
    """
    while True:
        begin_s = clock()
        observation = observe_vehicle(request)
        tell(observation)
        sleep(max(PAUSE_S, begin_s + request.interval_s - clock()) if observation.is_verdict else PAUSE_S)


def observe_vehicle(request: WatchRequest) -> Observation:
    """Take one look at the vehicle."""
    now_ns = time.time_ns()
    try:
        taken = request.look()
        observation = _verified(request, taken)
    except MissingDependencyError:
        raise
    except UnfitSnapshotError as refusal:
        outcome: Outcome = "moving" if refusal.code == "moving_vehicle" else "failed"
        return Observation(now_ns, outcome, str(refusal))
    except MultilicaError as failure:
        return Observation(now_ns, "failed", str(failure))
    except Exception as failure:  # noqa: BLE001 - a watch goes on, whatever one look meets
        text = f"This is a bug in multilica, not in the vehicle ({type(failure).__name__}: {failure})."
        return Observation(now_ns, "failed", MultilicaError(text).args[0])
    return observation


def _verified(request: WatchRequest, taken: TakenSnapshot) -> Observation:
    snapshot = taken.snapshot
    require_calibratable(snapshot)
    frame_ids = {lidar.name: lidar.frame_id for lidar in snapshot.lidars}
    known, absent = read_reference(request.calibration, frame_ids), absent_lidars(request.calibration, frame_ids)
    found = register_from_known(snapshot, known, request.config)
    check = check_found(found, snapshot, known, request.tolerances.without(absent))
    # A chosen topic that is silent was not left out on purpose.
    chosen = request.config.ingest.chooses_topics and not taken.silent
    check = with_absent(check, absent, request.tolerances, chosen=chosen)
    reasons = [f"{each.lidar}: {each.reason}" for each in check.lidars if each.verdict != "within"]
    silent = [f"{topic} sends no scan" for topic in taken.silent]
    text = " ".join([check.sentence, *(f"{reason}." for reason in (*reasons, *silent))])
    last_ns = max(scan.log_time_ns or scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans)
    return replace(Observation(last_ns, check.verdict, text, check, found, known), silent=taken.silent)
