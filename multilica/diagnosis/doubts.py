# SPDX-License-Identifier: Apache-2.0
"""Doubts about a result that do not belong to one LiDAR without a pose."""

import math
from collections.abc import Iterator

from multilica.diagnosis.explanation import in_words
from multilica.results.document import ResultDocument
from multilica.results.values import LEAST_IMPLAUSIBLE

_BIASES = (
    ("its ranges", "range_bias_sigma_m"),
    ("its elevation angles", "elevation_bias_sigma_deg"),
    ("the scale of its ranges", "range_scale_sigma"),
    ("its ranges on grazed surfaces", "glancing_bias_sigma_m"),
)
"""Words for each bias of a LiDAR, with the key of its usual size."""


def warnings_of(document: ResultDocument) -> Iterator[str]:
    """Yield a sentence per doubt: knocks, no ground, unchecked placements, odd sensors, priors far off, odd pairs."""
    yield from (
        f"{knock.text}. Check how {' or '.join((knock.lidar, *knock.rivals))} is fastened, then calibrate again."
        for knock in document.knocks
    )
    yield from _snapshot_warnings(document)
    yield from _time_warnings(document)
    yield from _ground_warnings(document)
    if document.accepted_by == "fitness" and len(document.placed) > 1:
        yield (
            "the placements were accepted by their fitness alone "
            f"(preset {document.config.preset}, verify.enabled=false). A wrong pose can have a high fitness."
        )
    for name, entry in document.lidars.items():
        for reason in entry.health.reasons if entry.health is not None else ():
            if reason.code == "dirty":
                yield f"{name} has a dirty or covered window: {reason.text}."
    for entry in document.lidars.values():
        if entry.prior is not None and entry.prior.surprise:
            yield entry.prior.surprise
    yield from _bias_warnings(document)
    held = [name for name, entry in document.lidars.items() if entry.held_by_movable]
    if held:
        yield (
            f"{in_words(held)}: only objects that can move hold the pose in one direction. Record several frames "
            "(--frames 10), at a place where less moves."
        )
    for pair in document.refinement.pairs if document.refinement is not None else ():
        if pair.contradicts:
            yield (
                f"the pair {pair.source} against {pair.target} contradicts the others by "
                f"{pair.apart_m or 0.0:.3f} m, {pair.apart_deg or 0.0:.2f} deg, which happens to a correct pair with a "
                f"probability of {pair.probability:.1g}. One of the two LiDARs may be misplaced."
            )


def _bias_warnings(document: ResultDocument) -> Iterator[str]:
    """Yield a sentence per LiDAR whose systematic errors are larger than its datasheet allows."""
    for bias in document.refinement.biases if document.refinement is not None else ():
        errors = bias.range_m, math.radians(bias.elevation_deg), 1e-6 * bias.range_scale_ppm, bias.glancing_m
        allowed = document.config.refine.bias_sigmas(bias.lidar)
        shares = [abs(error) / sigma for error, sigma in zip(errors, allowed, strict=True)]
        largest = max(shares)
        if largest > LEAST_IMPLAUSIBLE:
            which, key = _BIASES[shares.index(largest)]
            yield (
                f"{bias.lidar} seems to have an error in {which}, {largest:.0f} times its usual size (refine.{key}), "
                "and sigma is larger for that. Check the units and the calibration that its driver uses."
            )


def _time_warnings(document: ResultDocument) -> Iterator[str]:
    if document.time_limit is not None:
        not_reached = ", ".join(f"{one} - {other}" for one, other in document.time_limit.not_reached) or "none"
        yield (
            f"the time limit (--max-time {document.time_limit.max_time_s:g} s) ended the search. Pairs that "
            f"were not reached: {not_reached}. Another run on the same input may reach more or fewer."
        )
        if unlinked := ", ".join(f"{one} - {other}" for one, other in document.time_limit.unlinked_stops):
            yield f"there was no time for further links between stops: {unlinked}."


def _ground_warnings(document: ResultDocument) -> Iterator[str]:
    if document.ground_refusal:
        yield f"there is no base frame on the ground: {document.ground_refusal}."
    if document.ground is not None and document.ground.doubt:
        yield f"the base frame {document.ground.frame} on the ground is uncertain: {document.ground.doubt}."


def _snapshot_warnings(document: ResultDocument) -> Iterator[str]:
    """Yield a sentence per snapshot that is left out, or that others outvote though no knock explains it."""
    knocked = {(stop, knock.lidar) for knock in document.knocks for stop in knock.left_out}
    for snapshot in document.snapshots:
        if snapshot.refusal:
            yield f"{snapshot.name} is left out: {snapshot.refusal.rstrip('.')}."
        for each in snapshot.deviations:
            if each.outlier and (snapshot.name, each.lidar) not in knocked:
                yield (
                    f"{snapshot.name} places {each.lidar} {each.text} from the other snapshots, which outvote it. If "
                    f"{snapshot.name} is the latest one, {each.lidar} may have moved: check how it is fastened."
                )
