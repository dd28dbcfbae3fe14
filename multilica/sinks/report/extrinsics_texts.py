# SPDX-License-Identifier: Apache-2.0
"""Extrinsics of a run as texts to copy from its report."""

from dataclasses import dataclass

import numpy as np

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results.document import ResultDocument
from multilica.sinks.files.result_files import calibration_toml
from multilica.sinks.text.extrinsics_text import matrix_text, urdf_text


@dataclass(frozen=True, slots=True)
class ExtrinsicsText:
    """A text with its format: `key` for programs, `label` for people, `title` for what it holds."""

    key: str
    label: str
    title: str
    text: str


def extrinsics_texts(document: ResultDocument) -> list[ExtrinsicsText]:
    """Return `calibration.toml`, URDF and matrices as `multilica export` writes them; none without a placed LiDAR.

    URDF and matrices are left out if a name cannot stand in such files.
    """
    extrinsics = _exported(document)
    if len(extrinsics.members) < 2:
        return []
    texts = [ExtrinsicsText("toml", "TOML", "calibration.toml", calibration_toml(document))]
    if all(name.isprintable() and name == name.strip() != "" for name in extrinsics.members):
        inside = f"in the frame {extrinsics.target}"
        texts += [
            ExtrinsicsText("urdf", "URDF", f"URDF, fixed joints {inside}", urdf_text(extrinsics)),
            ExtrinsicsText("matrices", "matrices", f"4 x 4 matrices {inside}", matrix_text(extrinsics)),
        ]
    return texts


def _exported(document: ResultDocument) -> Extrinsics:
    """Return the placed LiDARs in the base frame, if the run has one with x, y and yaw, else in the target's frame."""
    target, ground = document.target, document.ground
    poses = {name: pose for name, pose in document.poses.items() if document.lidars[name].placed and name != target}
    found = Extrinsics(target, poses)
    if not poses or ground is None or ground.T_base_target_rig is None or ground.doubt:
        return found
    return found.seen_from(RigidTransform(ground.frame, target, np.asarray(ground.T_base_target)))
