# SPDX-License-Identifier: Apache-2.0
"""Tables of a run with a row per pair and per candidate of the merge."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import pyarrow as pa

from multilica.results import MergeDecision, PairKey, PairRegistration, PairResidual
from multilica.sinks.run_state import RunState

_TEXT, _COUNT, _NUMBER, _FLAG = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")

PAIR_COLUMNS: Mapping[str, pa.DataType] = MappingProxyType(
    {
        **dict.fromkeys(("target", "source"), _TEXT),
        **dict.fromkeys(("matches", "hypotheses"), _COUNT),
        **dict.fromkeys(("pose_from", "verdict", "reasons"), _TEXT),
        **dict.fromkeys(
            ("evidence", "fitness", "rmse_m", "coverage", "violation_share", "sigma_m", "sigma_deg"), _NUMBER
        ),
        **dict.fromkeys(("rig_residual_m", "rig_residual_deg", "rig_weight", *_POSE), _NUMBER),
    }
)
"""Of the table of pairs; a figure that is not known is null, a text empty. The pose is `T_target_source`."""
MERGE_COLUMNS: Mapping[str, pa.DataType] = MappingProxyType(
    {
        **dict.fromkeys(("merge_step", "rank"), _COUNT),
        **dict.fromkeys(("target", "source"), _TEXT),
        **dict.fromkeys(("evidence", "fitness", "rmse_m"), _NUMBER),
        **dict.fromkeys(("verdict", "reason"), _TEXT),
        **dict.fromkeys(("chosen", "of_groups"), _FLAG),
    }
)
"""Of the table of merge candidates; steps and ranks count from 1."""


def pair_rows(state: RunState) -> list[dict[str, object]]:
    """Return a row per pair that was matched or registered."""
    refinement = None if state.result is None else state.result.refinement
    residuals = (
        {} if refinement is None else {state.key_of(each.target, each.source): each for each in refinement.pairs}
    )
    return [_pair_row(state, pair, residuals.get(pair)) for pair in state.pairs]


def _pair_row(state: RunState, pair: PairKey, residual: PairResidual | None) -> dict[str, object]:
    found, coarse = state.registrations.get(pair), state.coarse.get(pair)
    row: dict[str, object] = {
        "target": pair[0],
        "source": pair[1],
        "matches": len(state.matches.get(pair, ())),
        "hypotheses": 0 if coarse is None else len(coarse.hypotheses),
        **dict.fromkeys(("pose_from", "reasons"), ""),
        "verdict": "no pose",
        **{name: None for name, kind in PAIR_COLUMNS.items() if kind == _NUMBER},
    }
    row |= {} if found is None else _figures(pair, found)
    if residual is not None:
        row |= {"rig_residual_m": residual.after_m, "rig_residual_deg": residual.after_deg}
        row["rig_weight"] = residual.weight
    return row


def _figures(pair: PairKey, found: PairRegistration) -> dict[str, object]:
    pose = found.T_target_source.with_target(pair[0])
    return {
        "pose_from": found.start_name,
        "verdict": found.verdict.outcome,
        "reasons": ",".join(found.verdict.codes),
        **found.figures,
        **dict(zip(_POSE, (*pose.xyz_m.tolist(), *pose.quaternion_xyzw.tolist()), strict=True)),
    }


def merge_rows(decisions: Sequence[MergeDecision]) -> list[dict[str, object]]:
    """Return a row per merge step and candidate, in the order in which they were ranked."""
    return [
        {
            "merge_step": decision.step + 1,
            "rank": rank,
            "target": one.target,
            "source": one.source,
            "evidence": one.evidence,
            "fitness": one.fitness,
            "rmse_m": one.rmse_m,
            "verdict": "accept" if one.passes else "uncertain" if one.uncertain else "refused",
            "reason": one.reason,
            "chosen": one == decision.chosen,
            "of_groups": one.of_groups,
        }
        for decision in decisions
        for rank, one in enumerate(decision.candidates, start=1)
    ]
