# SPDX-License-Identifier: Apache-2.0
"""Explanation of an uncertain pose."""

from multilica.diagnosis.causes import ADVICE
from multilica.diagnosis.explanation import Uncertain
from multilica.results.document import ResultDocument


def explain_uncertain(document: ResultDocument, name: str) -> Uncertain:
    """Name the standard deviation of an uncertain LiDAR that is above its limit, with its direction."""
    limits = document.config.acceptance
    (sigma_m, along), (sigma_deg, about) = document.lidars[name].weakest_directions()
    if sigma_m > limits.max_sigma_m:
        direction = f"mostly along {along} of {document.target}"
        sigma, limit = f"{1e3 * sigma_m:.1f} mm", f"{1e3 * limits.max_sigma_m:g} mm"
    else:
        direction = f"mostly about {about} of {document.target}"
        sigma, limit = f"{sigma_deg:.3f} deg", f"{limits.max_sigma_deg:g} deg"
    return Uncertain(
        name,
        f"{name} is uncertain: sigma {sigma} {direction}, limit {limit}.",
        direction,
        sigma_m,
        sigma_deg,
        limits.max_sigma_m,
        limits.max_sigma_deg,
        ADVICE["uncertain"],
    )
