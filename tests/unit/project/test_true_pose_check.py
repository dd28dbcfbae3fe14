# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.events import CloudPreprocessed, PairRegistered
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Verdict
from tests.bench.support import true_pose_check
from tests.bench.support.true_pose_check import Trial, Watch, is_borne_out, try_truth
from tests.unit.made_rooms import HALL, box, scan

_POSES = {
    "t": RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4]),
    "s": RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2]),
}
_TRUTH = Extrinsics("world", _POSES)
_TUNNEL = box((-200.0, -4.0, 0.0), (200.0, 4.0, 4.0))


def _tried(objects):
    watch = Watch()
    for seed, (name, pose) in enumerate(_POSES.items()):
        watch(CloudPreprocessed(scan(name, pose, objects, seed=seed)))
    return try_truth(watch, [("t",), ("s",)], _TRUTH, CalibrationConfig())["s"]


@pytest.mark.slow
def test_the_truth_of_a_hall_would_have_been_accepted():
    assert _tried(HALL) == Trial(accepted=True, codes=())


@pytest.mark.slow
@pytest.mark.nightly
def test_the_truth_of_a_tunnel_is_not_constrained():
    trial = _tried(_TUNNEL)
    assert not trial.accepted
    assert {*trial.codes} & {"not_observable", "ambiguous"}


@pytest.mark.parametrize(
    ("refused_for", "accepted", "codes", "borne_out"),
    [
        (["too_little_evidence"], False, ["too_little_evidence"], True),
        (["too_little_evidence", "ambiguous"], False, ["ambiguous"], True),
        (["not_observable"], False, ["too_little_evidence"], False),
        (["not_observable"], False, ["imprecise"], True),
        (["not_observable"], False, ["ambiguous"], True),
        (["ambiguous"], True, [], False),
        (["empty_space_violated"], False, ["not_observable"], True),
        (["empty_space_violated"], False, ["empty_space_violated"], False),
        (["empty_space_violated", "too_little_evidence"], False, ["ambiguous"], True),
        (["empty_space_violated", "too_little_evidence"], True, [], False),
        (["too_little_evidence"], False, ["ambiguous"], False),
        (["structure_unexplained"], False, ["too_far_apart"], True),
        ([], False, ["too_little_evidence"], True),
        ([], True, [], False),
    ],
)
def test_a_refusal_is_borne_out_by_the_same_kind_of_reason(refused_for, accepted, codes, borne_out):
    assert is_borne_out(refused_for, Trial(accepted, tuple(codes))) is borne_out


def test_true_poses_join_a_lidar_by_way_of_another_group(monkeypatch):
    accepted = {"ab": Trial(accepted=True, codes=()), "bc": Trial(accepted=True, codes=())}
    refusal = Trial(accepted=False, codes=("too_little_evidence",))

    def tried(_, first, second, *__):
        return accepted.get(first[0] + second[0], refusal)

    monkeypatch.setattr(true_pose_check, "_try", tried)
    trials = try_truth(Watch(), [("a",), ("b", "e"), ("c",), ("d",)], _TRUTH, CalibrationConfig())
    assert {name: trial.accepted for name, trial in trials.items()} == {"b": True, "e": True, "c": True, "d": False}
    assert trials["c"].codes == refusal.codes


def test_the_last_registration_between_groups_has_the_reasons():
    watch = Watch()
    for target, source, codes in (("t", "s", ["first"]), ("u", "t", ["other"]), ("s", "t", ["second", "third"])):
        reasons = tuple(Reason(code, 0.0, 1.0, code) for code in codes)
        pose = RigidTransform(target, source, np.eye(4))
        made = PairRegistration(target, source, pose, 0.5, 0.1, 9, converged=False, iterations=3, engine="made")
        watch(PairRegistered(replace(made, verdict=Verdict("reject", reasons))))
    assert watch.refusal(("t", "u"), ("s",)) == ("second", "third")
    assert watch.refusal(("s",), ("u",)) == ()


def test_empty_clouds_are_not_kept():
    watch = Watch()
    watch(CloudPreprocessed(SimpleNamespace(lidar="t", points_m=np.zeros((0, 3)))))
    assert watch.clouds == {}
